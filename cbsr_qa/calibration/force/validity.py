"""Reasons why a force model is valid in less than a recipe's intended range."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.domain.numbers import Mask
from cbsr_qa.domain.results.calibration import BatchUse
from cbsr_qa.domain.results.observation import LoadObservation
from cbsr_qa.domain.sensor.patterns import DrivePattern

#: Number of places below which most of the map is its mean. Chosen by us.
_FEW_PLACES: Final = 6
#: Number of loads of a sensor, without its batch, from which on U holds its 95 %: 4 to 6 that scatter by 4 % hold 85
#: to 88 (docs/explanation/uncertainty.md).
_ENOUGH_LOADS: Final = 9
#: Number of loads named one by one; the rest are counted.
_MAX_NAMED_LOADS: Final = 6


def force_reductions(learned: LearnedForce, loads: Sequence[LoadObservation]) -> Iterator[str]:
    """Yield gaps in the information from a model's loads, which are in the order of ``learned.refused``."""
    loads_by_reason: dict[str, list[LoadObservation]] = {}
    used_loads = []
    for load, why in zip(loads, learned.refused, strict=True):
        if why:
            loads_by_reason.setdefault(why, []).append(load)
        else:
            used_loads.append(load)
    for why, members in loads_by_reason.items():
        yield f"no force was learned from {_name_loads(members)}: {why}"
    if words := prediction_words(learned):
        yield words
    if learned.model.batch is not None and not learned.model.batch.alike:
        yield batch_words(learned.model.batch)
    places = {load.place_mm for load in used_loads}
    if len(places) < _FEW_PLACES:
        yield (f"force was learned at only {len(places)} places: elsewhere their mean response is assumed")
    if len(used_loads) < _ENOUGH_LOADS and learned.model.batch is None:
        yield (
            f"the scatter of loads is known from only {len(used_loads)}: stated uncertainties may hold fewer than 95"
            " % of errors"
        )
    strains = {round(load.record.load.strain, 6) for load in used_loads}
    alike_strain = f"all loads were pressed at one strain ({100 * strains.pop():g} %)" if len(strains) == 1 else ""
    if not learned.fitted_intercept:
        lowest, highest = learned.model.stress_kPa
        alike = f"all loads had the same stress ({lowest:.3g} to {highest:.3g} kPa)"
        unstated = "" if learned.line.intercept.stderr else ", which states no uncertainty of it"
        yield (
            f"{alike_strain or alike}: the intercept of the material's characteristic cannot be separated from the"
            f" sheet's response and is taken from the material{unstated}"
        )
    elif alike_strain:
        yield alike_strain


def prediction_words(learned: LearnedForce) -> str:
    """Return how many loads of a model were predicted from short holds, and to which time; empty if none was."""
    count = sum(learned.predicted)
    if not count:
        return ""
    length = "only briefly" if all(learned.predicted) else "for a shorter time than the run's longest"
    source = " with the relaxation of the batch" if all(learned.predicted) else ""
    return (
        f"{count} of {len(learned.predicted)} loads were held {length}: their readings and forces were"
        f" predicted{source} to {learned.model.steady_s:.0f} s after the press"
    )


def batch_words(batch: BatchUse) -> str:
    """Return what a map owes to the sensor's batch."""
    model = f"model {batch.model[:12]}"
    if not batch.alike:
        return (
            f"the sensor is not like its batch (p = {batch.p_value:.2g} by {model}): its map is that of its own loads"
            " alone"
        )
    return (
        f"the map also rests on the sensor's batch ({model}): {batch.share:.0%} of its variance would be gone if the"
        f" batch's common map were known exactly; the loads are like the batch's (p = {batch.p_value:.2g})"
    )


def list_untrained_ranges(used: Sequence[LoadObservation], confirmed: Sequence[LoadObservation]) -> Iterator[str]:
    """Yield ranges covered only by loads (``confirmed``) used to test the force, not to learn it."""
    forces, forces_tested = (
        [load.force_N for load in loads if load.force_N is not None] for loads in (used, confirmed)
    )
    if forces and forces_tested and (min(forces_tested) < min(forces) or max(forces_tested) > max(forces)):
        yield (
            f"force was learned from {min(forces):.3g} to {max(forces):.3g} N; {len(forces_tested)} further loads"
            f" from {min(forces_tested):.3g} to {max(forces_tested):.3g} N agree with it within three standard errors"
        )
    radii, radii_tested = ([float(np.hypot(*load.place_mm)) for load in loads] for loads in (used, confirmed))
    if radii and radii_tested and max(radii_tested) > max(radii):
        yield (
            f"force was learned up to {max(radii):.3g} mm from the centre;"
            f" loads up to {max(radii_tested):.3g} mm agree with it"
        )


def list_missing_forces(loads: Sequence[LoadObservation]) -> Iterator[str]:
    """Yield why loads have no force although a load cell recorded one, each reason once."""
    silent: dict[str, list[LoadObservation]] = {}
    for load in loads:
        if load.no_force:
            silent.setdefault(load.no_force, []).append(load)
    for why, members in silent.items():
        yield f"no force was measured of {_name_loads(members)}: {why}"


def reading_reductions(pattern: DrivePattern, usable: Mask) -> Iterator[str]:
    """Yield unusable readings of a sensor, and electrodes without usable readings."""
    expected_mask = pattern.usable()
    missing_count = int((expected_mask & ~usable).sum())
    if not missing_count:
        return
    yield f"{missing_count} readings were not imaged: saturated, constant or not connected"
    drive, measure = np.array(pattern.drive), np.array(pattern.measure)
    dead_electrodes = []
    for electrode in range(pattern.electrode_count):
        drives_mask, measures_mask = (drive == electrode).any(axis=1), (measure == electrode).any(axis=1)
        touching_mask = expected_mask & (drives_mask[:, None] | measures_mask[None, :])
        if touching_mask.any() and not (touching_mask & usable).any():
            dead_electrodes.append(electrode)
    if dead_electrodes:
        subject = (
            f"electrode {dead_electrodes[0]} is"
            if len(dead_electrodes) == 1
            else f"electrodes {', '.join(map(str, dead_electrodes))} are"
        )
        yield f"{subject} dead: not one of its readings could be used, and forces beside it are less certain"


def _name_loads(loads: Sequence[LoadObservation]) -> str:
    presses = [load.record.load for load in loads[:_MAX_NAMED_LOADS]]
    named = [f"{press.label} at ({press.x_mm:zg}, {press.y_mm:zg}) mm, trial {press.trial}" for press in presses]
    others_named = f" and {len(loads) - _MAX_NAMED_LOADS} more" if len(loads) > _MAX_NAMED_LOADS else ""
    return ", ".join(named) + others_named
