"""Presses of a sheet, each located from others alone: the basis of mixture, regions and stated errors."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.mixture import LEVELS, learn_mixture, mahalanobis, mix_places
from cbsr_qa.calibration.place.process import condition_on_presses, leave_out, likely_scales
from cbsr_qa.calibration.place.templates import TemplateLearning, fill_missing, likeness, match, predict_features
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import PatternTurns, PlaceMixture, PlaceProcess, PlaceScales

#: Largest number of presses that are left out in blocks of a few, with hyperparameters from nine tenths of the
#: presses; number of these blocks, and of the sets that hyperparameters leave out.
_FEW: Final = 120
_BLOCKS_OF_FEW: Final = 40
_BLOCKS_WITH_SCALES: Final = 10
#: Number of blocks in which larger sets are left out in turn, in the order in which they were made.
_BLOCKS: Final = 20
#: Presses closer than this share of the radius are at the same place.
_ONE_PLACE: Final = 0.01
#: Presses that hyperparameters are found with. Of more than :data:`_FEW` each half is located with those of the other
#: half; of more than _MANY times as many, all but these are located with hyperparameters from these, and these with
#: those from as many others.
_FOR_SCALES: Final = 200
_MANY: Final = 4
#: Fewest places that tell how wide regions are. In 40 draws of nine presses of two real skins, regions of 68 % held
#: 30 to 99 % of other presses, and the errors of presses left out told nothing of the errors of others.
FEWEST_FOR_REGIONS: Final = 30
#: Levels at which the actual coverage of regions is compared with the nominal one.
_LEVELS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, LEVELS[0], 0.75, 0.8, 0.85, 0.9, LEVELS[1], 0.975, 0.99)


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Errors of presses located without learning from them.

    Parameters
    ----------
    mean_mm, stderr_mm : distance of the found from the true places.
    count, places : presses, and their different places.
    presses : (count,) indices of the presses.
    found_mm : (count, 2) places found.
    levels, held : (k,) nominal and actual coverage of regions; the sizes of the regions were found with other
        presses.
    """

    mean_mm: float
    stderr_mm: float
    count: int
    places: int
    presses: Indices
    found_mm: Array
    levels: Array
    held: Array

    @property
    def coverage(self) -> tuple[float, float] | None:
        """Shares of the presses inside the regions of 68 and 95 %; None if too few places tell how wide these are."""
        if self.places < FEWEST_FOR_REGIONS:
            return None
        low, high = (float(self.held[self.levels == level][0]) for level in LEVELS)
        return low, high


@dataclass(frozen=True, slots=True, eq=False)
class LeftOut:
    """Both estimates (k, 2) of presses (k,) from others.

    The second has a covariance (k, 2, 2), a misfit (k,), and the likeness (k, g) to templates over the grid.
    """

    presses: Indices
    process: Array
    templates: Array
    templates_covariance: Array
    misfit: Array
    likeness: Array

    def select(self, chosen: Indices | Mask) -> "LeftOut":
        """Some of them."""
        return LeftOut(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def mixture(self, places_mm: Array, levels: Sequence[float] = LEVELS) -> PlaceMixture:
        """Mixture learned from presses at places (n, 2), with regions of some levels."""
        parts = self.process, self.templates, self.templates_covariance, places_mm[self.presses]
        return learn_mixture(*parts, visits_of(places_mm)[self.presses], levels)

    def measure_errors(self, mixture: PlaceMixture, places_mm: Array) -> tuple[Array, Array]:
        """Errors (k, 2) of the mixed places, and dᵀΣ⁻¹d (k,) of them."""
        mixed_mm, covariance = mix_places(mixture, self.process, self.templates, self.templates_covariance)
        error = places_mm[self.presses] - mixed_mm
        return error, mahalanobis(error, covariance)


@dataclass(frozen=True, slots=True, eq=False)
class PressedSheet:
    """Features (n, m) of presses and their places (n, 2) about the centre, in the electrodes' axes."""

    turns: PatternTurns
    features: Array
    places_mm: Array

    @property
    def radius_mm(self) -> float:
        """Radius of the circle about the centre that holds all presses."""
        return float(np.linalg.norm(self.places_mm, axis=1).max())

    @property
    def visits(self) -> Indices:
        """Index of the first press at its place, for each press (n,)."""
        return visits_of(self.places_mm)

    def likely(self, presses: Indices) -> PlaceScales:
        """Hyperparameters from some of the presses."""
        return likely_scales(self.turns, self.features[presses], self.places_mm[presses])

    def template_learning(self) -> TemplateLearning:
        """Learning of the templates of the presses."""
        return TemplateLearning(self.turns, self.features, self.places_mm, self.radius_mm)

    def blocks(self) -> list[Indices]:
        """Presses that are left out together."""
        visits = self.visits
        firsts = np.unique(visits)
        most_blocks = _BLOCKS_OF_FEW if len(visits) <= _FEW else _BLOCKS
        groups = np.array_split(firsts, min(most_blocks, len(firsts)))
        return [np.flatnonzero(np.isin(visits, group)) for group in groups]

    def fill(self, missing: Mask) -> "PressedSheet":
        """Sheet whose missing features (n, m) follow from presses of other blocks, as in frames to come."""
        learning, features = self.template_learning(), self.features.copy()
        for block in self.blocks():
            presses = block[missing[block].any(axis=1)]
            if len(presses):
                templates = learning.leave_out_block(block)
                features[presses] = fill_missing(
                    templates, predict_features(templates), features[presses], missing[presses]
                )
        return replace(self, features=features)

    def leave_out(self, learning: TemplateLearning, later: Array | None) -> tuple[LeftOut, PlaceProcess]:
        """Locate presses from presses of other blocks, at other places, and learn the process from all."""
        count, blocks = len(self.places_mm), self.blocks()
        places = np.empty((count, 2))
        for learned, located in self.presses_for_scales():
            process, inverse = condition_on_presses(self.likely(learned), self.turns, self.features, self.places_mm)
            predicted = leave_out(process, inverse, [block for block in blocks if np.isin(block, located).any()])
            places[located] = predicted[located]
        if count <= _MANY * _FOR_SCALES:  # otherwise it is the last one
            scales = self.likely(evenly(count, _FOR_SCALES))
            process, _ = condition_on_presses(scales, self.turns, self.features, self.places_mm)
        return LeftOut(np.arange(count), places, *self._from_templates(learning, blocks, later)), process

    def growth_by_drift(self, learning: TemplateLearning, sessions: float) -> float:
        """Factor by which squared errors may have grown so many sessions later; 1 where they do not grow.

        The larger one of that of the readings' misfits and that of the squared errors of places: drift may move most
        readings little, and those that tell the place much. By a random walk, presses differ from the mean of the
        other half in order by 5/12 of what it gains in a session, from that of presses in between by 1/6, and later
        by 1/3 and what it gains until then.
        """
        count = len(self.places_mm)
        presses = np.arange(count)
        separated, mixed = (
            self._errors_left_out(learning, halves)
            for halves in ([presses[: count // 2], presses[count // 2 :]], [presses[::2], presses[1::2]])
        )
        return max(1.0, 1 + (4 * sessions + 2 / 3) * float((separated / mixed).max() - 1))

    def _errors_left_out(self, learning: TemplateLearning, blocks: Sequence[Indices]) -> Array:
        """Usual misfit of readings at the places, and squared error of places, of presses left out in blocks."""
        misfits = np.concatenate([learning.misfits_left_out(block) for block in blocks])
        apart_mm2 = ((self._from_templates(learning, blocks)[0] - self.places_mm) ** 2).sum(axis=1)
        usual = np.log(np.maximum(apart_mm2, np.finfo(float).tiny)).mean()
        return np.array([np.median(misfits), np.exp(usual)])

    def presses_for_scales(self) -> list[tuple[Indices, Indices]]:
        """Presses for hyperparameters, and presses at other places located with them."""
        count, visits = len(self.places_mm), self.visits
        visit_numbers = np.unique(visits)
        if count <= _FEW:
            groups = [group for group in np.array_split(visit_numbers, _BLOCKS_WITH_SCALES) if len(group)]
            masks = [np.isin(visits, group) for group in groups]
            return [(np.flatnonzero(~mask), np.flatnonzero(mask)) for mask in masks]
        chosen_visits = visit_numbers[1::2]
        if count > _MANY * _FOR_SCALES:
            chosen_visits = visit_numbers[evenly(len(visit_numbers), min(_FOR_SCALES, len(visit_numbers) // 2))]
        chosen_mask = np.isin(visits, chosen_visits)
        chosen, others = np.flatnonzero(chosen_mask), np.flatnonzero(~chosen_mask)
        return [
            (learned[evenly(len(learned), _FOR_SCALES)], located)
            for learned, located in ((others, chosen), (chosen, others))
        ]

    def _from_templates(
        self, learning: TemplateLearning, blocks: Sequence[Indices], later: Array | None = None
    ) -> tuple[Array, Array, Array, Array]:
        estimates: list[tuple[Array, Array, Array, Array]] = []
        for block in blocks:
            templates, features = learning.leave_out_block(block, later), self.features[block]
            estimates.append((*match(templates, features), likeness(predict_features(templates), features)))
        order = np.argsort(np.concatenate(blocks))
        place, covariance, misfit, press_likeness = (
            np.concatenate(column)[order] for column in zip(*estimates, strict=True)
        )
        return place, covariance, misfit, press_likeness


def visits_of(places_mm: Array) -> Indices:
    """Index of the first press at its place, for each press (n,) at places (n, 2) about their centre."""
    cells = np.round(places_mm / (_ONE_PLACE * np.linalg.norm(places_mm, axis=1).max()))
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return first[cell.ravel()]


def coverage_of(out: LeftOut, places_mm: Array) -> HeldOut:
    """State errors and coverage of presses left out; mixture and regions are learned from the other half of places.

    The standard error counts presses at one place as one.
    """
    count, visits = len(out.presses), visits_of(places_mm)[out.presses]
    half_of = np.unique(visits, return_inverse=True)[1] % 2
    found_mm, covered_mask = np.empty((count, 2)), np.empty((count, len(_LEVELS)))
    for half in (0, 1):
        located_presses = np.flatnonzero(half_of == half)
        mixture = out.select(half_of != half).mixture(places_mm, _LEVELS)
        offset_mm, ratio = out.select(located_presses).measure_errors(mixture, places_mm)
        found_mm[located_presses] = places_mm[out.presses[located_presses]] - offset_mm
        covered_mask[located_presses] = ratio[:, None] <= mixture.quantiles
    error = np.linalg.norm(places_mm[out.presses] - found_mm, axis=1)
    mean, stderr = mean_by_place(error, visits)
    places = len(np.unique(visits))
    return HeldOut(mean, stderr, count, places, out.presses, found_mm, np.array(_LEVELS), covered_mask.mean(axis=0))


def mean_by_place(values: Array, visits: Indices) -> tuple[float, float]:
    """Mean of values (n,) and its standard error, for which those of one index in ``visits`` (n,) count as one."""
    sums = np.bincount(visits, values - values.mean())[np.unique(visits)]
    stderr = np.sqrt(np.sum(sums**2) * len(sums) / max(len(sums) - 1, 1)) / len(values)
    return float(values.mean()), float(stderr)


def late_growth(mixture: PlaceMixture, early: LeftOut, late: LeftOut, places_mm: Array) -> float:
    """Factor by which squared errors of late presses exceed those of earlier ones, at least 1.

    Geometric mean of the factor by the readings' misfit, for which few presses suffice, and of the factor by the
    places. On a scale of logarithms no single press counts much.
    """
    misfit, ratio = (
        [np.log(np.maximum(factors, np.finfo(float).tiny)).mean() for factors in pair]
        for pair in (
            (early.misfit, late.misfit),
            (early.measure_errors(mixture, places_mm)[1], late.measure_errors(mixture, places_mm)[1]),
        )
    )
    return max(1.0, float(np.exp((misfit[1] - misfit[0] + ratio[1] - ratio[0]) / 2)))


def evenly(count: int, most: int) -> Indices:
    """Indices of at most ``most`` of ``count`` presses, evenly spread over the session."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
