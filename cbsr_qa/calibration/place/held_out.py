"""Presses of a sheet, each located from others alone: the basis of mixture, regions and stated errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.drift import SESSIONS
from cbsr_qa.calibration.place.mixture import LEVELS, learn_mixture, mahalanobis, mixed
from cbsr_qa.calibration.place.process import given_presses, left_out, likely_scales
from cbsr_qa.calibration.place.templates import expected_features, learn_templates, likeness, match
from cbsr_qa.domain import Array, Indices
from cbsr_qa.domain.results import PatternTurns, PlaceScales, PlaceTemplates

#: Up to so many presses are located with all but a few others; hyperparameters are found again without each tenth.
_FEW: Final = 120
_BLOCKS_OF_FEW: Final = 40
_BLOCKS_WITH_SCALES: Final = 10
#: Larger sets are left out in turn in this many blocks, in the order in which they were made.
_BLOCKS: Final = 20
#: Presses closer than this share of the radius are at the same place.
_ONE_PLACE: Final = 0.01
#: Above that each half of the presses is located with hyperparameters of so many of the other half.
_FOR_HALVES: Final = 200
#: Levels at which the actual coverage of regions is compared with the nominal one.
_LEVELS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, LEVELS[0], 0.75, 0.8, 0.85, 0.9, LEVELS[1], 0.975, 0.99)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Errors of presses located without learning from them.

    Parameters
    ----------
    mean_mm, stderr_mm : distance of the found from the true places.
    count : presses.
    presses : (count,) their indices.
    found_mm : (count, 2) places found.
    levels, held : (k,) nominal and actual coverage of regions; the sizes of the regions were found with other
        presses.
    """

    mean_mm: float
    stderr_mm: float
    count: int
    presses: Indices
    found_mm: Array
    levels: Array
    held: Array

    @property
    def coverage(self) -> tuple[float, float]:
        """Shares of the presses inside the regions of 68 and 95 %."""
        low, high = (float(self.held[self.levels == level][0]) for level in LEVELS)
        return low, high


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Both estimates (n, 2) of every press from others.

    For the second also its covariance (n, 2, 2), misfit (n,), and the likeness (n, k) to templates over the grid.
    """

    process: Array
    templates: Array
    templates_covariance: Array
    misfit: Array
    likeness: Array


@dataclass(frozen=True, slots=True, eq=False)
class PressedSheet:
    """Features (n, m), places (n, 2) about the centre in the electrodes' axes, and times (n,) of presses.

    ``time`` runs from −½ to ½ over the session.
    """

    turns: PatternTurns
    features: Array
    places_mm: Array
    time: Array

    @property
    def radius_mm(self) -> float:
        """Of the circle about the centre that holds all presses."""
        return float(np.linalg.norm(self.places_mm, axis=1).max())

    @property
    def visits(self) -> Indices:
        """Index of the first press at its place, for each press (n,)."""
        return visits_of(self.places_mm)

    def likely(self, presses: Indices) -> PlaceScales:
        """Hyperparameters from some of the presses."""
        return likely_scales(self.turns, self.features[presses], self.places_mm[presses])

    def templates(self, presses: Indices) -> tuple[PlaceTemplates, Array]:
        """Templates of some of the presses, and their drift; see :func:`learn_templates`."""
        parts = self.features[presses], self.places_mm[presses]
        return learn_templates(self.turns, *parts, self.radius_mm, self.time[presses])

    def left_out(self) -> LeftOut:
        """Locate every press from presses of other blocks, which are at other places."""
        count, visits = len(self.places_mm), self.visits
        places = np.unique(visits)
        groups = np.array_split(places, min(_BLOCKS_OF_FEW if count <= _FEW else _BLOCKS, len(places)))
        blocks = [np.flatnonzero(np.isin(visits, group)) for group in groups]
        process = np.full((count, 2), np.nan)
        for learned, located in self._parts():
            given, inverse = given_presses(self.likely(learned), self.turns, self.features, self.places_mm)
            predicted = left_out(given, inverse, [block for block in blocks if np.isin(block, located).any()])
            process[located] = predicted[located]
        return LeftOut(process, *self._from_templates(blocks))

    def misfit_growth(self) -> float:
        """Factor by which misfits may have grown after :data:`SESSIONS`; 1 if they do not grow.

        A random walk of features: half a session away the misfit's median has grown by a tenth of the total.
        """
        count = len(self.places_mm)
        presses, still = np.arange(count), replace(self, time=np.zeros(count))
        apart, mixed = (
            float(np.median(still._from_templates(halves)[2]))
            for halves in ([presses[: count // 2], presses[count // 2 :]], [presses[::2], presses[1::2]])
        )
        return max(1.0, 1 + 2 * SESSIONS * (apart / mixed - 1))

    def _parts(self) -> list[tuple[Indices, Indices]]:
        """Presses for hyperparameters, and presses located with them."""
        count = len(self.places_mm)
        if count > _FEW:
            halves = np.arange(0, count, 2), np.arange(1, count, 2)
            return [(one[evenly(len(one), _FOR_HALVES)], other) for one, other in (halves, halves[::-1])]
        blocks = np.array_split(np.arange(count), _BLOCKS_WITH_SCALES)
        return [(np.setdiff1d(np.arange(count), block), block) for block in blocks if len(block)]

    def _from_templates(self, blocks: Sequence[Indices]) -> tuple[Array, Array, Array, Array]:
        found: list[tuple[Array, Array, Array, Array]] = []
        for block in blocks:
            others = np.setdiff1d(np.arange(len(self.places_mm)), block)
            templates, _ = self.templates(others)
            features = self.features[block]
            found.append((*match(templates, features), likeness(expected_features(templates), features)))
        order = np.argsort(np.concatenate(blocks))
        place, covariance, misfit, like = (np.concatenate(part)[order] for part in zip(*found, strict=True))
        return place, covariance, misfit, like


def visits_of(places_mm: Array) -> Indices:
    """Index of the first press at its place, for each press (n,) at places (n, 2) about their centre."""
    cells = np.round(places_mm / (_ONE_PLACE * np.linalg.norm(places_mm, axis=1).max()))
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    visits: Indices = first[cell.ravel()]
    return visits


def coverage_of(out: LeftOut, places_mm: Array, visits: Indices) -> HeldOut:
    """State errors and coverage of presses left out; mixture and regions are learned from the other half of them.

    The standard error counts presses at one place (of the same index in ``visits``) as one.
    """
    count = len(places_mm)
    places, inside = np.empty((count, 2)), np.empty((count, len(_LEVELS)))
    for half in (0, 1):
        located, learned = np.arange(half, count, 2), np.arange(1 - half, count, 2)
        first, second, second_covariance = out.process, out.templates, out.templates_covariance
        parts = first[learned], second[learned], second_covariance[learned], places_mm[learned]
        mixture = learn_mixture(*parts, _LEVELS)
        places[located], covariance = mixed(mixture, first[located], second[located], second_covariance[located])
        ratio = mahalanobis(places_mm[located] - places[located], covariance)
        inside[located] = ratio[:, None] <= mixture.quantiles
    error = np.linalg.norm(places_mm - places, axis=1)
    sums = np.bincount(visits, error - error.mean())[np.unique(visits)]
    stderr = float(np.sqrt(np.sum(sums**2) * len(sums) / max(len(sums) - 1, 1)) / count)
    return HeldOut(
        float(error.mean()), stderr, count, np.arange(count), places, np.array(_LEVELS), inside.mean(axis=0)
    )


def evenly(count: int, most: int) -> Indices:
    """Indices of at most ``most`` of ``count`` presses, evenly spread over the session."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
