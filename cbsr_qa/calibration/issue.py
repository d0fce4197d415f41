"""Issuing a calibration from a run that passed."""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Final

import numpy as np

from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.calibration.force.validity import (
    force_reductions,
    list_missing_forces,
    list_untrained_ranges,
    reading_reductions,
)
from cbsr_qa.calibration.sheet.baseline import baseline_conductance, load_baseline
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.kept import as_filed, take_sources
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.calibration import (
    BaselineConductance,
    Calibration,
    LoadRelaxation,
    SettlingSummary,
    Validity,
)
from cbsr_qa.domain.results.learned_place import PlaceOfRun
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic

_INTERCEPT: Final = "β against stress"
#: Parameters taken from the material; a force model may have fitted the intercept.
_ASSUMED: Final = ("α against stress", _INTERCEPT, "α against strain", "β against strain")


def issue_calibration(
    observation: RunObservation,
    verdict: Verdict,
    *,
    calibration: str,
    issued_at: str,
    phases: Sequence[str],
    overlap_threshold: float,
    noise_figure: float | None = None,
    learned: LearnedForce | None = None,
    learned_from: Sequence[LoadObservation] = (),
    confirmed: Sequence[LoadObservation] = (),
    no_force: str = "",
    place: PlaceOfRun | None = None,
    standards: Sequence[ReferenceStandard] = (),
) -> Calibration:
    """Issue a calibration.

    Parameters
    ----------
    observation : observation of the finished run.
    verdict : verdict of the run; only passed and marginal ones get a calibration.
    calibration, issued_at : identity (time-ordered UUID as text) and wall clock (ISO with zone).
    phases : names of the phases whose loads are used.
    overlap_threshold : lowest area overlap the recipe accepts [%].
    noise_figure : noise figure measured on this sensor; None if the recipe did not request it.
    learned : force model of the sensor; its line replaces the material's α, β against stress, since its map was
        learned with it. None for the reason ``no_force``.
    learned_from : loads that were used or refused, in the order of ``learned.refused``.
    confirmed : other loads whose force it predicted within its stated error: they widen the range.
    place : learned from the run's presses; None to locate by the model of the sheet.
    standards : reference standards that the station states.

    Raises
    ------
    CalibrationError
        If the run did not pass or was not finished, no load of those phases gave a baseline conductance, the drive
        current is unknown, or ``issued_at`` is not a time with a zone. Single unusable loads only reduce the
        validity, each with its reason.
    """
    _check_passed(observation, verdict)
    utc, material = _utc(issued_at), observation.record.material
    loads = [load for load in observation.loads if load.phase in phases]
    against_stress = material.against_stress if learned is None else learned.line
    baseline, used_loads = _baseline(observation, loads, phases, against_stress)
    why = "" if learned else no_force or "no force model was requested"
    fitted = _INTERCEPT if learned is not None and learned.fitted_intercept else ""
    if learned is None:
        force_reduced = [f"no force model: {why}"]
    else:
        used_loads = [load for load, refusal in zip(learned_from, learned.refused, strict=True) if not refusal]
        force_reduced = [*force_reductions(learned, learned_from), *list_untrained_ranges(used_loads, confirmed)]
    reduced = _list_reductions(observation, baseline, loads, force_reduced)
    relaxations = tuple(_relaxations(observation.tested))
    return stamp(
        Calibration(
            **take_sources(Calibration, observation),
            calibration=calibration,
            issued_at=utc,
            current_A=_current_A(observation),
            reconstruction=as_filed(observation.reconstruction),
            baseline=baseline,
            against_stress=against_stress,
            against_strain=material.against_strain,
            assumed=tuple(parameter for parameter in _ASSUMED if parameter != fitted),
            settling=summarise_settling(relaxations),
            overlap_threshold=overlap_threshold,
            validity=_validity(observation, [*used_loads, *confirmed], reduced),
            relaxations=relaxations,
            noise_figure=noise_figure,
            force=None if learned is None else as_filed(learned.model),
            place=None if learned is None else place,
            no_force=why,
            standards=tuple(standards),
        )
    )


def _baseline(
    observation: RunObservation,
    loads: Sequence[LoadObservation],
    phases: Sequence[str],
    against_stress: QuasiStatic,
) -> tuple[tuple[BaselineConductance, ...], list[LoadObservation]]:
    """ρ̄₀ of every location, and the loads that contributed."""
    noise, mask = observation.noise_images, observation.main_mask
    baseline = baseline_conductance(loads, against_stress, noise, mask)
    used_loads = [load for load in loads if load_baseline(load, against_stress, noise, mask).value is not None]
    if not used_loads:
        reasons = "; ".join(dict.fromkeys(place.why for place in baseline)) or f"no load in {', '.join(phases)}"
        raise CalibrationError(f"no load gives a baseline conductance: {reasons}")
    return baseline, used_loads


def _list_reductions(
    observation: RunObservation,
    baseline: Sequence[BaselineConductance],
    loads: Sequence[LoadObservation],
    force_reduced: Sequence[str],
) -> list[str]:
    """Return what reduces the validity: places left out, missing forces, the force model, and unusable readings."""
    reduced = [
        f"{place.location} at ({place.x_mm:zg}, {place.y_mm:zg}) mm is left out: {place.why}"
        for place in baseline
        if place.value is None
    ]
    reduced += list_missing_forces(loads)
    reduced += force_reduced
    reduced += reading_reductions(observation.record.sensor_type.pattern, observation.usable)
    return reduced


def summarise_settling(relaxations: Sequence[LoadRelaxation]) -> tuple[SettlingSummary, ...]:
    """Summarise settling times by signal and direction; Kaplan–Meier means, lower bounds where any is censored."""
    groups: dict[tuple[str, bool], list[LoadRelaxation]] = {}
    for relaxation in relaxations:
        groups.setdefault((relaxation.signal, relaxation.loading), []).append(relaxation)
    return tuple(_summary(signal, loading, members) for (signal, loading), members in groups.items())


def _summary(signal: str, loading: bool, members: Sequence[LoadRelaxation]) -> SettlingSummary:
    timed = [m.settling for m in members if m.settling.value_s is not None]
    times = [t.value_s for t in timed if t.value_s is not None]
    censored = [t.censored for t in timed]
    mean, deviation = estimate_restricted_mean(times, censored) if times else (None, None)
    return SettlingSummary(
        signal, loading, mean, deviation, len(timed) - sum(censored), sum(censored), len(members) - len(timed)
    )


def _check_passed(observation: RunObservation, verdict: Verdict) -> None:
    record = observation.record
    if record.end is not EndReason.FINISHED:
        raise CalibrationError(f"run {record.identity.run} was not finished ({record.end}): no calibration is issued")
    if verdict.outcome not in (Outcome.PASS, Outcome.MARGINAL):
        raise CalibrationError(f"the verdict is {verdict.outcome}, so no calibration is issued: {verdict.reason}")


def _utc(issued_at: str) -> str:
    """Normalise the spelling of a time, so that a calibration rebuilt from a database has the same digest."""
    try:
        moment = datetime.fromisoformat(issued_at)
    except ValueError as error:
        raise CalibrationError(f"issued at {issued_at!r}, which is not an ISO time") from error
    if moment.tzinfo is None:
        raise CalibrationError(f"issued at {issued_at!r}, which states no zone")
    return moment.astimezone(UTC).isoformat()


def _current_A(observation: RunObservation) -> float:
    current_A = observation.unloaded.current_A
    if current_A is None:
        raise CalibrationError("the drive current of the reference frames is not known")
    return current_A


def _relaxations(loads: Sequence[LoadObservation]) -> Iterator[LoadRelaxation]:
    for load in loads:
        place = load.record.load
        for relaxation in load.relaxations:
            yield LoadRelaxation(
                location=place.label,
                trial=place.trial,
                signal=relaxation.signal,
                loading=relaxation.loading,
                fit=relaxation.fit,
                settling=relaxation.settling,
                phase=load.phase,
                load=load.record.index,
                strain=place.strain,
                unit=relaxation.trace.unit,
            )


def _validity(observation: RunObservation, reached: Sequence[LoadObservation], reduced: Sequence[str]) -> Validity:
    """Range of the loads that force was learned from or agrees with, else of those with a baseline conductance."""
    forces = [load.force_N for load in reached if load.force_N is not None]
    strains = [load.record.load.strain for load in reached]
    return Validity(
        force_N=(min(forces), max(forces)) if forces else None,
        strain=(min(strains), max(strains)),
        temperature_C=_temperature_C(observation),
        radius_mm=max(float(np.hypot(*load.place_mm)) for load in reached),
        reduced=tuple(reduced),
    )


def _temperature_C(observation: RunObservation) -> tuple[float, float] | None:
    recorded = [phase.channel("temperature") for phase in observation.record.phases]
    values = [block.values for block in recorded if block is not None and len(block)]
    if not values:
        return None
    joined = np.concatenate(values)
    return float(joined.min()), float(joined.max())
