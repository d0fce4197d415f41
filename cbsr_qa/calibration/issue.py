"""Issuing a calibration from a run that passed."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from cbsr_qa.calibration.file import as_filed, stamped
from cbsr_qa.calibration.fits import restricted_mean
from cbsr_qa.calibration.force import LearnedForce, force_reductions, reading_reductions, tried_beyond, unmeasured
from cbsr_qa.calibration.sheet import baseline_conductance, load_baseline
from cbsr_qa.domain import CalibrationError, taken
from cbsr_qa.domain.results import (
    BaselineConductance,
    Calibration,
    EndReason,
    ForceModel,
    LoadObservation,
    LoadRelaxation,
    Outcome,
    RunObservation,
    SettlingSummary,
    Validity,
    Verdict,
)
from cbsr_qa.domain.sensor import QuasiStatic


def issue_calibration(
    observation: RunObservation,
    verdict: Verdict,
    *,
    calibration: str,
    issued_at: str,
    phases: Sequence[str],
    overlap_threshold: float,
    measured_stress: QuasiStatic | None = None,
    measured_strain: QuasiStatic | None = None,
    noise_figure: float | None = None,
    learned: LearnedForce | None = None,
    learned_from: Sequence[LoadObservation] = (),
    confirmed: Sequence[LoadObservation] = (),
    no_force: str = "",
) -> Calibration:
    """Issue a calibration.

    Parameters
    ----------
    observation : of the finished run.
    verdict : of the run; only passed and marginal ones get a calibration.
    calibration, issued_at : identity (time-ordered UUID as text) and wall clock (ISO with zone).
    phases : names of the phases whose loads are used.
    overlap_threshold : lowest area overlap the recipe accepts [%].
    measured_stress, measured_strain : α, β where this sensor was characterised; else the material's are used and
        named in ``assumed``.
    noise_figure : measured on this sensor; None where the recipe did not ask for it.
    learned : force model of the sensor; its line takes the place of α, β against stress, since its map was learned
        with it. None where there is none: ``no_force`` then says why.
    learned_from : the loads it was learned from or that it refused, in the order of ``learned.refused``.
    confirmed : loads it was not learned from whose force it told within its stated error: they widen the range.

    Returns
    -------
    Calibration with its digests; ``issued_at`` is in UTC.

    Raises
    ------
    CalibrationError
        If the run did not pass or was not finished, no load of those phases gave a baseline conductance, the drive
        current is not known, or ``issued_at`` is no time with a zone. Single loads that say nothing only reduce the
        validity, each with its reason.
    """
    _check_passed(observation, verdict)
    material = observation.record.material
    identity = _Issue(calibration, _utc(issued_at), overlap_threshold, noise_figure)
    of_sensor = measured_stress or material.against_stress
    fits = _Fits(
        of_sensor if learned is None else learned.line,
        measured_strain or material.against_strain,
        _assumed(measured_stress, measured_strain, learned),
        learned,
        tuple(learned_from),
        tuple(confirmed),
        "" if learned else no_force or "nobody asked for a force model",
    )
    return stamped(_calibration(observation, _loads_of(observation, phases), fits, identity))


@dataclass(frozen=True, slots=True)
class _Issue:
    """What the caller says about a calibration."""

    calibration: str
    issued_at: str
    overlap_threshold: float
    noise_figure: float | None


@dataclass(frozen=True, slots=True)
class _Fits:
    """α and β that are used, which of them nobody measured on this sensor, and what was learned of force."""

    against_stress: QuasiStatic
    against_strain: QuasiStatic
    assumed: tuple[str, ...]
    learned: LearnedForce | None
    learned_from: tuple[LoadObservation, ...]
    confirmed: tuple[LoadObservation, ...]
    no_force: str

    @property
    def model(self) -> ForceModel | None:
        """The force model as its file holds it."""
        return None if self.learned is None else as_filed(self.learned.model)

    def used(self) -> list[LoadObservation] | None:
        """The loads force was learned from; None where it was not."""
        if self.learned is None:
            return None
        return [load for load, why in zip(self.learned_from, self.learned.refused, strict=True) if not why]


def _calibration(
    observation: RunObservation, loads: Sequence[LoadObservation], fits: _Fits, issue: _Issue
) -> Calibration:
    baseline, used = _baseline(observation, loads, fits.against_stress)
    relaxations = tuple(_relaxations(observation.tested))
    return Calibration(
        **taken(Calibration, observation),
        calibration=issue.calibration,
        issued_at=issue.issued_at,
        current_A=_current_A(observation),
        reconstruction=observation.reconstruction.in_single_precision(),
        baseline=baseline,
        against_stress=fits.against_stress,
        against_strain=fits.against_strain,
        assumed=fits.assumed,
        settling=summarise_settling(relaxations),
        overlap_threshold=issue.overlap_threshold,
        validity=_validity(observation, fits, loads, fits.used() or used, baseline),
        relaxations=relaxations,
        noise_figure=issue.noise_figure,
        force=fits.model,
        no_force=fits.no_force,
    )


def _loads_of(observation: RunObservation, phases: Sequence[str]) -> list[LoadObservation]:
    loads = [load for load in observation.loads if load.phase in phases]
    if not loads:
        raise CalibrationError(f"no load gives a baseline conductance: no load in {', '.join(phases)}")
    return loads


def _baseline(
    observation: RunObservation, loads: Sequence[LoadObservation], against_stress: QuasiStatic
) -> tuple[tuple[BaselineConductance, ...], list[LoadObservation]]:
    """ρ̄₀ of every location, and the loads that said something about it."""
    noise, mask = observation.noise_images, observation.main_mask
    baseline = baseline_conductance(loads, against_stress, noise, mask)
    used = [load for load in loads if load_baseline(load, against_stress, noise, mask).value is not None]
    if not used:
        reasons = (
            "; ".join(dict.fromkeys(place.why for place in baseline)) or "no load in the phases it is taken from"
        )
        raise CalibrationError(f"no load gives a baseline conductance: {reasons}")
    return baseline, used


def summarise_settling(relaxations: Sequence[LoadRelaxation]) -> tuple[SettlingSummary, ...]:
    """Summarise settling times by signal and direction, in the order they first occur.

    Mean and deviation are Kaplan–Meier restricted ones: where times are censored the mean is a lower bound.
    """
    groups: dict[tuple[str, bool], list[LoadRelaxation]] = {}
    for relaxation in relaxations:
        groups.setdefault((relaxation.signal, relaxation.loading), []).append(relaxation)
    return tuple(_summary(signal, loading, members) for (signal, loading), members in groups.items())


def _summary(signal: str, loading: bool, members: Sequence[LoadRelaxation]) -> SettlingSummary:
    timed = [m.settling for m in members if m.settling.value_s is not None]
    times = [t.value_s for t in timed if t.value_s is not None]
    censored = [t.censored for t in timed]
    mean, deviation = restricted_mean(times, censored) if times else (None, None)
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
    """One spelling of a time, so that a calibration put together again from a database has the same digest."""
    try:
        moment = datetime.fromisoformat(issued_at)
    except ValueError as error:
        raise CalibrationError(f"issued at {issued_at!r}, which is no ISO time") from error
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
        for seen in load.relaxations:
            yield LoadRelaxation(
                location=place.label,
                trial=place.trial,
                signal=seen.signal,
                loading=seen.loading,
                fit=seen.fit,
                settling=seen.settling,
                phase=load.phase,
                load=load.record.index,
                strain=place.strain,
                unit=seen.trace.unit,
            )


def _assumed(stress: QuasiStatic | None, strain: QuasiStatic | None, learned: LearnedForce | None) -> tuple[str, ...]:
    """What was taken from the material: an intercept that loads of this sensor were fitted with was not."""
    fitted = learned is not None and learned.fitted_intercept
    of_stress = ["α against stress", *([] if fitted else ["β against stress"])]
    return (*([] if stress else of_stress), *([] if strain else ["α against strain", "β against strain"]))


def _validity(
    observation: RunObservation,
    fits: _Fits,
    loads: Sequence[LoadObservation],
    used: Sequence[LoadObservation],
    baseline: Sequence[BaselineConductance],
) -> Validity:
    """Range of the loads that force was learned from, or, without such, of those with a baseline conductance.

    Loads that the learned force was tried on, and that bore it out, count as well.
    """
    reached = [*used, *fits.confirmed]
    forces = _forces_N(reached)
    strains = [load.record.load.strain for load in reached]
    radii = [float(np.hypot(load.record.load.x_mm, load.record.load.y_mm)) for load in reached]
    return Validity(
        force_N=(min(forces), max(forces)) if forces else None,
        strain=(min(strains), max(strains)),
        temperature_C=_temperature_C(observation),
        radius_mm=max(radii),
        reduced=tuple(_reductions(observation, fits, loads, baseline)),
    )


def _forces_N(loads: Sequence[LoadObservation]) -> list[float]:
    return [load.force_N for load in loads if load.force_N is not None]


def _temperature_C(observation: RunObservation) -> tuple[float, float] | None:
    recorded = [phase.channel("temperature") for phase in observation.record.phases]
    values = [block.values for block in recorded if block is not None and len(block)]
    if not values:
        return None
    joined = np.concatenate(values)
    return float(joined.min()), float(joined.max())


def _reductions(
    observation: RunObservation,
    fits: _Fits,
    loads: Sequence[LoadObservation],
    baseline: Sequence[BaselineConductance],
) -> Iterator[str]:
    for place in baseline:
        if place.value is None:
            yield f"{place.location} at ({place.x_mm:g}, {place.y_mm:g}) mm is left out: {place.why}"
    yield from unmeasured(loads)
    if fits.learned is None:
        yield f"no force can be told: {fits.no_force}"
    else:
        yield from force_reductions(fits.learned, fits.learned_from)
        yield from tried_beyond(fits.used() or [], fits.confirmed)
    yield from reading_reductions(observation.record.sensor_type.pattern, observation.usable)
