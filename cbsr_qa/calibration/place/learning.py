"""Learning places from presses at known places, with errors from left-out presses."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from cbsr_qa.calibration.place.drift import Drift, Session, find_drift, session_of
from cbsr_qa.calibration.place.faulty import Modelled, noisy_readings
from cbsr_qa.calibration.place.features import (
    ceilings_of,
    features_of,
    more_than_spikes,
    pattern_turns,
    predict_features,
    size_factors,
    spikes_among,
    strengths,
    turn_by,
)
from cbsr_qa.calibration.place.held_out import (
    FEWEST_FOR_REGIONS,
    HeldOut,
    PressedSheet,
    coverage_of,
    evenly,
    late_growth,
)
from cbsr_qa.calibration.place.mixture import widen_for_few_presses
from cbsr_qa.calibration.place.process import (
    frames_likelihoods,
    likely_scales,
    list_edge_hyperparameters,
    start_scales,
)
from cbsr_qa.calibration.place.templates import NO_PRESS, interpolate_at_places
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import FeatureScaling, LearnedPlace, PatternTurns, PlaceScales

FEWEST_PRESSES: Final = 6
#: Powers of readings and of a frame's size; see ``FeatureScaling``. On presses left out
#: of two unlike sheets, errors are within 2 % of one another for exponents of 0.65 to 0.85; the damping that the
#: presses make more likely is taken: half where all press alike, all of it where forces differ.
_EXPONENT: Final = 0.7
_DAMPINGS: Final = (0.5, 1.0)
#: Least gain in log likelihood per press for damping a frame's whole size.
_CLEARLY: Final = 0.2
#: Number of presses used to try damping, axes and centre, and steps of a half turn.
_FOR_FRAME: Final = 100
_AXES: Final = 24
#: Standard error of the centre along an axis, over the radius of what is pressed: of the presses' middle, and of a
#: centre that was registered.
_CENTRE: Final = 0.1
_KNOWN_CENTRE: Final = 0.03
#: Quantile of left-out presses that limits a touch's misfit, times an allowance for unseen presses.
_MISFIT_LEVEL: Final = 0.98
_MISFIT_ROOM: Final = 1.2
#: Least size of a touch, as a share of the 2 % quantile of learned sizes.
_SIZE_ROOM: Final = 0.5
#: Distance from the nearest press, in median distances of neighbours, beyond which places are outside.
_REACH: Final = 4.0
#: Share of the errors of always guessing the middle above which readings are hardly informative.
_POOR: Final = 0.6

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class FoundPresses:
    """Presses (k,) as they were found when they were left out, a re-check at the end with them.

    Parameters
    ----------
    presses : (k,) indices of the presses, in the order in which they were made.
    place_mm, strength : (k, 2) places and (k,) strengths of the changes; see
        :class:`~cbsr_qa.calibration.place.places.Places`.
    visits : (k,) number of the place, the same for presses at one place.
    session : times when the presses were made.
    drifts : True if readings were found to drift over the session.
    """

    presses: Indices
    place_mm: Array
    strength: Array
    visits: Indices
    session: Session
    drifts: bool


@dataclass(frozen=True, slots=True, eq=False)
class PlaceLearned:
    """A learned place, its errors on left-out presses, and remarks."""

    model: LearnedPlace
    held_out: HeldOut
    found: FoundPresses
    warnings: tuple[str, ...] = ()


def learn_place(
    changes: Array,
    places_mm: Array,
    pairs: Indices,
    electrodes: int,
    *,
    centre_mm: Array | None = None,
    axes: Array | None = None,
    time_s: Array | None = None,
    missing: Mask | None = None,
    modelled: Modelled | None = None,
    tell: Tell = lambda stage: None,
) -> PlaceLearned:
    """Learn places from changes of readings by presses.

    Parameters
    ----------
    changes : (n, m) changes of the readings by each press, in one unit; finite. Readings that are zero in all are not
        used, whatever they are later.
    places_mm : (n, 2) places of the presses in any frame; in the order in which they were made, unless ``time_s``
        says it.
    pairs : (m, 4) source, sink, plus, minus, electrodes from 0; no reading twice.
    electrodes : number of electrodes around the sheet, evenly spaced.
    centre_mm : (2,) centre of the sheet in the frame of the presses; by default their middle.
    axes : (2, 2) axes of the electrodes, as in ``LearnedPlace``, if they are known; those
        used are the likeliest.
    time_s : (n,) times of the presses; by default evenly spaced in their order. Drift over it is extrapolated.
    missing : (n, m) mask of readings that are zero because they are not known; spikes are found here.
    modelled : returns the changes (k, m) that the modelled sheet lets expect of presses (k,), in any unit; NaN where
        it does not. By default there is no modelled sheet.
    tell : function that receives the progress in words.

    Raises
    ------
    CalibrationError
        If there are fewer than six presses, all are at one place, no reading changes, or readings are the same in
        every press.
    """
    _check(changes, places_mm)
    order = np.arange(len(changes)) if time_s is None else np.argsort(time_s, kind="stable")
    missing = spikes_among(changes) if missing is None else spikes_among(changes) | missing
    changes = np.where(missing, 0.0, changes)
    if time_s is not None:
        changes, places_mm, time_s, missing = changes[order], places_mm[order], time_s[order], missing[order]
    turns = pattern_turns(pairs, electrodes)
    tell("finding how the electrodes lie")
    scaling, axes, centre = _frame(changes, places_mm, turns, axes, centre_mm)
    centred_mm = places_mm - centre
    sheet, size_ratio = _sheet(turns, changes, centred_mm @ axes.T, missing, scaling)
    tell("finding how readings drift")
    noisy_mask = _find_noise(pairs, sheet, changes, missing, scaling, order, modelled)
    if noisy_mask.any():
        changes = np.where(noisy_mask, 0.0, changes)
        sheet, size_ratio = _sheet(turns, changes, centred_mm @ axes.T, missing | noisy_mask, scaling)
    learning = sheet.template_learning()
    errors_and_expected = learning.leave_out_each()
    session = session_of(errors_and_expected[0], time_s)
    drift = find_drift(*errors_and_expected, session)
    growth, later = 1.0, None
    recheck_count = 0 if drift is None else drift.late
    if drift is not None:
        growth, later = sheet.growth_by_drift(learning, drift.horizon), drift.later
        sheet = replace(sheet, features=sheet.features + drift.since)
        learning = sheet.template_learning()
    tell("locating presses that were left out")
    left_out, process = sheet.leave_out(learning, later)
    tell("learning from all presses")
    recheck_mask = left_out.presses >= len(centred_mm) - recheck_count
    main_presses = left_out.select(~recheck_mask)
    mixture, region_widening = main_presses.mixture(sheet.places_mm), np.ones(2)
    if recheck_mask.any():
        growth = late_growth(mixture, main_presses, left_out.select(recheck_mask), sheet.places_mm)
        region_widening = widen_for_few_presses(int(recheck_mask.sum()))
    mixture = replace(mixture, quantiles=mixture.quantiles * region_widening)
    size = np.sqrt((changes**2).mean(axis=1))
    model = LearnedPlace(
        scaling,
        turns,
        process,
        learning.leave_out_block(NO_PRESS, later),
        replace(mixture, spread=growth * mixture.spread),
        centre,
        axes,
        misfit=float(_MISFIT_ROOM * growth * np.quantile(main_presses.misfit, _MISFIT_LEVEL)),
        least_size=float(_SIZE_ROOM * np.quantile(size, 1 - _MISFIT_LEVEL)),
        reach_mm=_reach(centred_mm[np.unique(sheet.visits)]),
    )
    held_out = coverage_of(main_presses, sheet.places_mm)
    located_mm = sheet.places_mm[left_out.presses] - left_out.measure_errors(mixture, sheet.places_mm)[0]
    located_mm[~recheck_mask] = held_out.found_mm
    left_out_likeness = (
        interpolate_at_places(model.templates.grid_mm, left_out.likeness, located_mm) / size_ratio[left_out.presses]
    )
    strength, visits = (
        strengths(changes[left_out.presses], left_out_likeness, scaling),
        sheet.visits[left_out.presses],
    )
    found_presses = FoundPresses(
        order[left_out.presses],
        located_mm @ axes + centre,
        strength,
        visits,
        session.select(left_out.presses),
        drifts=drift is not None,
    )
    held_out = replace(held_out, presses=order[held_out.presses], found_mm=held_out.found_mm @ axes + centre)
    drifts = () if drift is None else (_drift_words(drift, np.sqrt(growth * region_widening)),)
    warnings = *_warnings(held_out, sheet, process.scales), *_noise_words(noisy_mask[np.argsort(order)]), *drifts
    return PlaceLearned(model, held_out, found_presses, warnings)


def _sheet(
    turns: PatternTurns, changes: Array, places_mm: Array, missing: Mask, scaling: FeatureScaling
) -> tuple[PressedSheet, Array]:
    """Features of presses, whose missing readings (n, m) are filled in, and the factors (n,) of their sizes."""
    sheet, size_ratio = PressedSheet(turns, features_of(changes, scaling), places_mm), np.ones(len(changes))
    missing = missing & (scaling.ceiling > 0)
    if missing.any():
        known_features, sheet = sheet.features, sheet.fill(missing)
        heavy_loss_mask = more_than_spikes(missing, scaling.ceiling > 0)
        size_ratio[heavy_loss_mask] = size_factors(
            known_features[heavy_loss_mask], sheet.features[heavy_loss_mask], scaling
        )
        sheet = replace(sheet, features=sheet.features * size_ratio[:, None])
    return sheet, size_ratio


def _find_noise(
    pairs: Indices,
    sheet: PressedSheet,
    changes: Array,
    missing: Mask,
    scaling: FeatureScaling,
    order: Indices,
    modelled: Modelled | None,
) -> Mask:
    """Mask (n, m) of readings that are noise in single presses; ``order`` (n,) numbers these for ``modelled``."""

    def expect(presses: Indices) -> Array:
        if modelled is None:
            return np.full((len(presses), len(pairs)), np.nan)
        return predict_features(modelled(order[presses]), changes[presses], scaling)

    errors = sheet.template_learning().leave_out_each()[0]
    return noisy_readings(pairs, sheet.features, errors, missing, expect)


def _noise_words(noisy: Mask) -> Iterator[str]:
    rows = np.flatnonzero(noisy.any(axis=1))
    if rows.size:
        yield (
            f"presses in which the readings of one electrode are noise, and are left out: {rows.size}; the first is"
            f" press {rows[0] + 1} of those used"
        )


def _check(changes: Array, places_mm: Array) -> None:
    if len(changes) < FEWEST_PRESSES:
        raise CalibrationError(
            f"{len(changes)} presses; learning places needs {FEWEST_PRESSES} or more",
            remedy="press at more places, all over the sheet",
        )
    if not np.ptp(places_mm, axis=0).any():
        raise CalibrationError("all presses are at one place", remedy="press all over the sheet")
    if not changes.any():
        raise CalibrationError(
            "no reading changes in any press", remedy="check that these are readings of the presses"
        )
    if not np.ptp(changes, axis=0).any():
        raise CalibrationError(
            "all readings are the same in every press: they do not tell the place",
            remedy="check that these are readings of the presses",
        )


def _frame(
    changes: Array, places_mm: Array, turns: PatternTurns, axes: Array | None, centre_mm: Array | None
) -> tuple[FeatureScaling, Array, Array]:
    """Find the most likely damping, and axes and centre of the electrodes.

    First with the initial scales of a search, then with the likeliest in that frame. A sheet rotated with its
    electrodes looks the same after half a turn, so half a turn of axes is tried, after those beside known ones: on a
    sheet that is not as modelled, readings may be symmetric about others (28° off on a real one).
    """
    presses = evenly(len(changes), _FOR_FRAME)
    centre = (places_mm.min(axis=0) + places_mm.max(axis=0)) / 2 if centre_mm is None else np.asarray(centre_mm)
    centred_mm = places_mm[presses] - centre
    stderr_mm = float(np.linalg.norm(centred_mm, axis=1).max()) * (_CENTRE if centre_mm is None else _KNOWN_CENTRE)
    candidate_axes = _half_turn() if axes is None else np.concatenate([_turn_axes(axes), _half_turn()])
    candidates = []
    for damping in _DAMPINGS:
        scaling = FeatureScaling(_EXPONENT, damping, ceilings_of(changes))
        features = features_of(changes[presses], scaling)
        likelihoods, centres = frames_likelihoods(
            start_scales(features, centred_mm), turns, features, centred_mm, candidate_axes, stderr_mm
        )
        best = int(likelihoods.argmax())
        penalty = _CLEARLY * len(presses) * (damping - _DAMPINGS[0])
        candidates.append((float(likelihoods[best]) - penalty, scaling, candidate_axes[best], centres[best]))
    _, scaling, likely_axes, shift = max(candidates, key=lambda each: each[0])
    features = features_of(changes[presses], scaling)
    scales = likely_scales(turns, features, (centred_mm - shift) @ likely_axes.T)
    candidate_axes = np.concatenate([candidate_axes, _turn_axes(likely_axes)])
    likelihoods, centres = frames_likelihoods(scales, turns, features, centred_mm, candidate_axes, stderr_mm)
    best = int(likelihoods.argmax())
    return scaling, candidate_axes[best], centre + centres[best]


def _half_turn() -> Array:
    angles = np.linspace(0, np.pi, _AXES, endpoint=False)
    return np.array([turn_by(angle, mirrored=mirrored) for mirrored in (False, True) for angle in angles])


def _turn_axes(axes: Array) -> Array:
    """Axes (a, 2, 2) within 10° of known ones, themselves first."""
    angles = np.radians([0.0, -10, -7.5, -5, -2.5, 2.5, 5, 7.5, 10])
    return np.array([turn_by(angle, mirrored=False) @ axes for angle in angles])


def _reach(about: Array) -> float:
    """Distance from the nearest of some different places (n, 2) beyond which nothing was learned [mm].

    Neighbours along a line say nothing about the places beside it: they count as no farther apart than as many places
    at random in the same area are on average (Clark & Evans 1954), by that of their convex hull (Efron 1965). Places
    between neighbours are within reach in any case.
    """
    nearest_mm, area_mm2 = float(np.median(np.asarray(cKDTree(about).query(about, k=2)[0])[:, 1])), 0.0
    if np.linalg.matrix_rank(about - about[0]) == 2:
        hull = ConvexHull(about)
        area_mm2 = hull.volume / (1 - len(hull.vertices) / (len(about) + 1))
    spread_mm = 0.5 * float(np.sqrt(area_mm2 / len(about)))
    return max(_REACH * min(nearest_mm, spread_mm), nearest_mm)


def _warnings(held_out: HeldOut, sheet: PressedSheet, scales: PlaceScales) -> Iterator[str]:
    """Remarks for a person on the learned place."""
    spread_mm = float(np.linalg.norm(sheet.places_mm - sheet.places_mm.mean(axis=0), axis=1).mean())
    if held_out.mean_mm > _POOR * spread_mm:
        yield (
            f"the readings hardly depend on the place: the mean error of presses left out is {held_out.mean_mm:.1f}"
            f" mm; always guessing the middle of the presses gives {spread_mm:.1f} mm"
        )
    if held_out.coverage is None:
        yield (
            f"{held_out.places} places do not tell how wide regions are: from nine, those of 68 % held 30 to 99 % of"
            f" other presses; press at {FEWEST_FOR_REGIONS} or more places"
        )
    at_edge = list_edge_hyperparameters(scales, sheet.features, sheet.places_mm)
    if at_edge:
        yield f"hyperparameters at the edge of their range: {', '.join(at_edge)}; press at more places"


def _drift_words(drift: Drift, wider: Array) -> str:
    """Say how much wider (2,) regions of 68 and 95 % are than those whose coverage is stated."""
    return (
        f"readings drift over the session: regions are widened, those of 68 % by a factor of {wider[0]:.3g} and those"
        f" of 95 % by {wider[1]:.3g}, to hold until {drift.horizon:g} times its length after the last press; the"
        " stated coverage is that of regions before widening; press at some known places again before that"
    )
