"""Presses of a sheet, each located from others alone: what mixture, regions and stated errors rest on."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.mixture import learn_mixture, mahalanobis, mixed
from cbsr_qa.calibration.place.process import given_presses, left_out, likely_scales
from cbsr_qa.calibration.place.templates import learn_templates, match
from cbsr_qa.domain import Array, Indices
from cbsr_qa.domain.results import PatternTurns, PlaceScales

#: Blocks of presses, in the order in which they were made, that are left out in turn: drift over a session is seen.
_BLOCKS: Final = 20
#: Up to so many presses hyperparameters are found anew without each block, of which there are fewer then.
_FOR_BLOCKS: Final = 120
_BLOCKS_WITH_SCALES: Final = 10
#: Above that each half of the presses is located with hyperparameters of so many of the other half.
_FOR_HALVES: Final = 200


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Errors of presses that nothing was learned from when they were located.

    Parameters
    ----------
    mean_mm, stderr_mm : distance of the places found from the true ones.
    count : presses.
    coverage : shares of them inside the regions of 68 and 95 %, whose sizes were found with all others.
    """

    mean_mm: float
    stderr_mm: float
    count: int
    coverage: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Both estimates (n, 2) of every press from others, and the second's covariance (n, 2, 2) and misfit (n,)."""

    process: Array
    templates: Array
    templates_covariance: Array
    misfit: Array


@dataclass(frozen=True, slots=True, eq=False)
class PressedSheet:
    """Features (n, m) and places (n, 2) of presses, about the centre in the electrodes' axes."""

    turns: PatternTurns
    features: Array
    places_mm: Array

    @property
    def radius_mm(self) -> float:
        """Of the circle about the centre that holds all presses."""
        return float(np.linalg.norm(self.places_mm, axis=1).max())

    def likely(self, presses: Indices) -> PlaceScales:
        """Hyperparameters from some of the presses."""
        return likely_scales(self.turns, self.features[presses], self.places_mm[presses])

    def left_out(self) -> LeftOut:
        """Locate every press from presses of other blocks."""
        count = len(self.places_mm)
        blocks = np.array_split(np.arange(count), min(_BLOCKS, count))
        process = np.full((count, 2), np.nan)
        for learned, located in self._parts():
            given, inverse = given_presses(self.likely(learned), self.turns, self.features, self.places_mm)
            predicted = left_out(given, inverse, [block for block in blocks if np.isin(block, located).any()])
            process[located] = predicted[located]
        return LeftOut(process, *self._from_templates(blocks))

    def _parts(self) -> list[tuple[Indices, Indices]]:
        """Presses that hyperparameters are found with, and those that are located with them."""
        count = len(self.places_mm)
        if count > _FOR_BLOCKS:
            halves = np.arange(0, count, 2), np.arange(1, count, 2)
            return [(one[evenly(len(one), _FOR_HALVES)], other) for one, other in (halves, halves[::-1])]
        blocks = np.array_split(np.arange(count), _BLOCKS_WITH_SCALES)
        return [(np.setdiff1d(np.arange(count), block), block) for block in blocks if len(block)]

    def _from_templates(self, blocks: list[Indices]) -> tuple[Array, Array, Array]:
        count = len(self.places_mm)
        places, covariances, misfit = np.empty((count, 2)), np.empty((count, 2, 2)), np.empty(count)
        for block in blocks:
            others = np.setdiff1d(np.arange(count), block)
            templates = learn_templates(self.turns, self.features[others], self.places_mm[others], self.radius_mm)
            places[block], covariances[block], misfit[block] = match(templates, self.features[block])
        return places, covariances, misfit


def coverage_of(out: LeftOut, places_mm: Array) -> HeldOut:
    """State errors and coverage of presses left out; mixture and regions are learned from the other half of them."""
    count = len(places_mm)
    error, inside = np.empty(count), np.empty((count, 2))
    for half in (0, 1):
        located, learned = np.arange(half, count, 2), np.arange(1 - half, count, 2)
        first, second, second_covariance = out.process, out.templates, out.templates_covariance
        mixture = learn_mixture(first[learned], second[learned], second_covariance[learned], places_mm[learned])
        found, covariance = mixed(mixture, first[located], second[located], second_covariance[located])
        apart = places_mm[located] - found
        error[located] = np.linalg.norm(apart, axis=1)
        inside[located] = mahalanobis(apart, covariance)[:, None] <= mixture.quantiles
    low, high = inside.mean(axis=0).tolist()
    return HeldOut(float(error.mean()), float(error.std(ddof=1) / np.sqrt(count)), count, (low, high))


def evenly(count: int, most: int) -> Indices:
    """Numbers of at most ``most`` of ``count`` presses, evenly spread over the session."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
