"""Press cycles of a strip run: resistance between the pins, stress within the cell's range, exclusions."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from cbsr_qa.analysis.defects.load_cell import limit_N
from cbsr_qa.analysis.run.reference import find_unloaded_frames
from cbsr_qa.calibration.strip.characterisation import Specimen, characterise
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Indenter, LoadRecord
from cbsr_qa.domain.results.characterisation import Characterisation, CycleReadings
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.domain.sensor.sensor_type import Parameter, SensorType
from cbsr_qa.eit.loads.bodies import StripModel

#: Points per hold into which samples are averaged: ten times fewer than the load cell's, and enough for seconds.
_POINTS: Final = 60
_FEWEST: Final = 8


@dataclass(frozen=True, slots=True, eq=False)
class HeldStress:
    """Stress through one hold: (n,) times from its start, and stress; empty if ``why`` is given."""

    time_s: Array
    stress_kPa: Array
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class StripForce:
    """The force of a phase.

    Parameters
    ----------
    samples : samples of the load cell, or None.
    area_mm2 : pressed area.
    limit_N : force at which the load cell saturated; None if it never did.
    """

    samples: SampleBlock | None
    area_mm2: float
    limit_N: float | None

    @property
    def notes(self) -> tuple[str, ...]:
        """Problems of the force as a whole."""
        return () if self.samples is not None else ("no force was recorded: the stress is unknown",)

    def stress(self, load: LoadRecord) -> HeldStress:
        """Stress through the hold of one press.

        Samples at the cell's limit are left out; a hold with any in its second half, or with most of its samples
        there, gives no relaxed stress.
        """
        no_values = np.zeros(0)
        if self.samples is None:
            return HeldStress(no_values, no_values)
        held_samples = self.samples.select_interval(load.hold_start_s, load.release_start_s)
        if len(held_samples) < _FEWEST:
            return HeldStress(no_values, no_values, "holds without force samples give no stress")
        below_limit_mask = (
            np.ones(len(held_samples), dtype=np.bool_) if self.limit_N is None else held_samples.values < self.limit_N
        )
        if (
            below_limit_mask.sum() < max(_FEWEST, len(held_samples) // 2)
            or not below_limit_mask[len(held_samples) // 2 :].all()
        ):
            reason = (
                f"the load cell is flat at its limit of {self.limit_N:.4g} N: the stress at"
                f" {100 * load.load.strain:g} % strain is unknown"
            )
            return HeldStress(no_values, no_values, reason)
        groups = np.array_split(np.flatnonzero(below_limit_mask), min(_POINTS, int(below_limit_mask.sum())))
        time_s = np.array([held_samples.time_s[group].mean() for group in groups]) - load.hold_start_s
        force_N = np.array([held_samples.values[group].mean() for group in groups])
        return HeldStress(time_s, force_N / self.area_mm2 * 1e3)


def strip_force(phase: PhaseRecord, area_mm2: float) -> StripForce:
    """Force of a phase, with the load cell's limit if it was reached."""
    samples = phase.channel("force")
    return StripForce(samples, area_mm2, None if samples is None else limit_N(samples, phase.loads))


_BEFORE: Final = 4  # readings before a press
_DEAD_SHARE: Final = 0.5  # of all readings; a pin without contact is saturated in most of them


@dataclass(frozen=True, slots=True, eq=False)
class _Pins:
    """Usable readings between the pins: times and resistances, (n,)."""

    time_s: Array
    ohm: Array

    def slice_time(self, start_s: float, end_s: float) -> "_Pins":
        inside_mask = (self.time_s >= start_s) & (self.time_s < end_s)
        return _Pins(self.time_s[inside_mask], self.ohm[inside_mask])


@lru_cache(maxsize=8)
def strip_model(
    sensor_type: SensorType, indenter: Indenter, contact_length_mm: float, place_mm: tuple[float, float]
) -> StripModel:
    """Model of a strip under a head; made once per process."""
    return StripModel(sensor_type, indenter, contact_length_mm, place_mm=place_mm)


def characterise_run(record: RunRecord, settings: CharacterisationSettings) -> Characterisation:
    """Characterise the material of a run's strip.

    Parameters
    ----------
    record : the run as stored, the only input. Cycles come from its phases with the role CHARACTERISATION.

    Raises
    ------
    NumericsError
        If the sensor type is not a strip, there are no cycles or no readings of the rested strip, or the pins do not
        carry the current.
    """
    phases = [phase for phase in record.phases if phase.role is Role.CHARACTERISATION and phase.loads]
    if not phases:
        raise NumericsError(
            "the run has no press cycles to characterise from",
            remedy="add a phase with sequence characterisation to the recipe",
        )
    contact_mm, error_mm = settings.contact_length_mm, settings.contact_length_stderr_mm
    strip, other_strip = (
        strip_model(record.sensor_type, record.indenter, length_mm, _place_mm(phases))
        for length_mm in (contact_mm, contact_mm + error_mm)
    )
    rested = _pins(find_unloaded_frames(record))
    _check_contact(phases)
    if not len(rested.ohm):
        raise NumericsError(
            "no usable reading of the rested strip", remedy="take more unloaded frames before the first press"
        )
    resistance_ohm = float(rested.ohm.mean())
    forces = [strip_force(phase, strip.pressed_mm2) for phase in phases]
    unread: list[str] = []
    readings = [
        cycle
        for phase, force in zip(phases, forces, strict=True)
        for cycle in _phase_cycles(phase, resistance_ohm, force, unread)
    ]
    count = len(rested.ohm)
    deviation = float(rested.ohm.std(ddof=1)) if count > 1 else 0.0
    identity = record.identity
    source = f"characterised in run {identity.run} on strip {identity.sensor.serial}"
    specimen = Specimen(
        strip=strip,
        other_contacts=other_strip,
        resistance_ohm=Parameter(resistance_ohm, deviation / count**0.5, source),
        relative_noise=deviation / resistance_ohm,
        declared=record.sensor_type.response,
        source=source,
    )
    notes = tuple(dict.fromkeys(note for force in forces for note in force.notes))
    return characterise(readings, specimen, settings, notes=notes, unread=unread)


def _place_mm(phases: list[PhaseRecord]) -> tuple[float, float]:
    places = {(load.load.x_mm, load.load.y_mm) for phase in phases for load in phase.loads}
    if len(places) > 1:
        raise NumericsError(
            f"the strip was pressed at {len(places)} places; cycles can be combined at one place only",
            remedy="press one place in a run",
        )
    return places.pop()


def _pins(frames: FrameBlock | None) -> _Pins:
    if frames is None:
        return _Pins(np.zeros(0), np.zeros(0))
    if frames.unit is not VoltageUnit.VOLT or not frames.current_A:
        raise NumericsError("the readings are not volts at a known current: resistance cannot be computed")
    good = (frames.flags[:, 0, 0] & UNUSABLE) == 0
    return _Pins(frames.time_s[good], frames.voltages[good, 0, 0] / frames.current_A)


def _check_contact(phases: list[PhaseRecord]) -> None:
    """Refuse pins that carry no current, and readings that never change."""
    frame_blocks = [phase.frames for phase in phases if phase.frames is not None and len(phase.frames)]
    if not frame_blocks:
        raise NumericsError("no frames were taken in the press cycles", remedy="take frames through holds and rests")
    flags = np.concatenate([frames.flags[:, 0, 0] for frames in frame_blocks])
    flagged = int(((flags & UNUSABLE) != 0).sum())
    if flagged > _DEAD_SHARE * len(flags):
        raise NumericsError(
            f"{flagged} of {len(flags)} readings are missing, or source or voltmeter was at its limit: a pin"
            " may be open",
            remedy="check both pins and their leads, or lower the current",
        )
    ohm = np.concatenate([_pins(frames).ohm for frames in frame_blocks])
    if not (ohm > 0).all():
        raise NumericsError(
            f"{int((ohm <= 0).sum())} of {len(ohm)} resistances between the pins are not positive",
            remedy="check how the pins are connected",
        )
    if np.ptp(ohm) == 0:
        raise NumericsError(
            f"all readings between the pins are stuck at {ohm[0]:.6g} Ω", remedy="check the voltmeter and the pins"
        )


def _phase_cycles(
    phase: PhaseRecord, resistance_ohm: float, force: StripForce, unread: list[str]
) -> list[CycleReadings]:
    pins = _pins(phase.frames)
    cycle_count_by_strain: dict[float, int] = {}
    cycles = []
    for load in phase.loads:
        strain = round(load.load.strain, 9)
        number = cycle_count_by_strain.get(strain, 0)
        cycle_count_by_strain[strain] = number + 1
        cycle = _cycle(load, number, pins, resistance_ohm, force)
        if min(len(cycle.held), len(cycle.rested)) < _FEWEST:
            unread.append(
                f"left out: cycle {number + 1} of {100 * strain:g} % strain has {len(cycle.held)} usable readings of"
                f" its hold and {len(cycle.rested)} of its rest; {_FEWEST} of each are needed"
            )
            continue
        cycles.append(cycle)
    return cycles


def _cycle(load: LoadRecord, number: int, pins: _Pins, resistance_ohm: float, force: StripForce) -> CycleReadings:
    held_pins = pins.slice_time(load.hold_start_s, load.release_start_s)
    rested_pins = pins.slice_time(load.unloaded_s, load.rest_end_s)
    ohm_before = pins.slice_time(-np.inf, load.press_start_s).ohm[-_BEFORE:]
    ramp_s = 0.0 if load.clear_s is None else load.clear_s - load.release_start_s
    stress = force.stress(load)
    return CycleReadings(
        load=load.index,
        strain=round(load.load.strain, 9),
        cycle=number,
        hold_start_s=load.hold_start_s,
        rest_start_s=load.unloaded_s,
        press_ramp_s=ramp_s,  # the head moves down as fast as up
        release_ramp_s=ramp_s,
        held_s=held_pins.time_s - load.hold_start_s,
        held=resistance_ohm / held_pins.ohm - 1,
        rested_s=rested_pins.time_s - load.unloaded_s,
        rested=resistance_ohm / rested_pins.ohm - 1,
        before=resistance_ohm / ohm_before - 1 if len(ohm_before) else np.zeros(1),
        stress_s=stress.time_s,
        stress_kPa=stress.stress_kPa,
        stress_why=stress.why,
    )
