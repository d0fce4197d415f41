"""From press cycles on a strip to its material's parameters (paper 2.2; science, sections 7 and 8)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np

from cbsr_qa.calibration.fits.common_relaxation import CommonRelaxation, fit_common_relaxation
from cbsr_qa.calibration.fits.settling import relaxation_start
from cbsr_qa.calibration.fits.superposition import (
    SeparatedSteps,
    StepTrace,
    constants_of,
    fit_step,
    separate_with_constants,
    shift_constants,
)
from cbsr_qa.calibration.strip.lines import (
    decide_response,
    fit_line,
    fit_modulus,
    lowest_clear_strain,
    strain_levels,
    why_reduced,
    why_refused,
)
from cbsr_qa.calibration.strip.relaxation import DirectedTrace, settlings, strip_relaxation, unit_kernel
from cbsr_qa.calibration.strip.slow_residue import SlowResidue, changes_of, separate_with_residue, subtract_residue
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.results.characterisation import (
    Characterisation,
    CycleChange,
    CycleReadings,
    FittedLine,
    StrainLevel,
    StrainSettling,
    StripFacts,
)
from cbsr_qa.domain.sensor.sensor_type import Parameter, Relaxation, Response, StripRelaxation
from cbsr_qa.eit.loads.bodies import StripModel


@dataclass(frozen=True, slots=True)
class Specimen:
    """The tested specimen.

    Parameters
    ----------
    strip : model with the assumed contacts.
    other_contacts : model with contacts one standard error higher.
    resistance_ohm : resistance between the pins of the rested strip.
    relative_noise : rms of one reading over their mean, rested.
    declared : response by the sensor type.
    source : source of everything that follows, e.g. the run.
    """

    strip: StripModel
    other_contacts: StripModel
    resistance_ohm: Parameter
    relative_noise: float
    declared: Response
    source: str


def characterise(
    readings: Sequence[CycleReadings],
    specimen: Specimen,
    settings: CharacterisationSettings,
    *,
    notes: Sequence[str] = (),
    unread: Sequence[str] = (),
) -> Characterisation:
    """Characterise a material.

    Changes between the pins are first converted to changes under the head with the forward model of the strip, since
    only these superpose. The steady change of a cycle is the final level of its hold less that of the rest before,
    both without residues of earlier presses (:mod:`cbsr_qa.calibration.fits`); the paper uses the readings at the
    end. Changes between the pins are converted back.

    NumericsError if there is no cycle, or changes are more than the strip under the head can make.

    Parameters
    ----------
    readings : cycles in order of time, the first one pressed on a rested strip.
    notes : further problems of the readings, for ``reduced``.
    unread : missing cycles, by name and with the reason.
    """
    if not readings:
        raise NumericsError(
            "no press cycle can be used", remedy="press the strip at several strains and read it throughout"
        )
    work = _Work(list(readings), specimen, settings)
    levels = strain_levels(work.cycles)
    response, disagreement = decide_response(levels, specimen.declared)
    lines = work.lines(levels)
    modulus, offset, why_no_modulus = fit_modulus(work.cycles, specimen.source)
    loading, unloading, stress = work.kernels()
    used_strains = [level.strain for level in levels if not level.why]
    lowest = lowest_clear_strain(lines["local_against_strain"].line, used_strains)
    material = Characterisation(
        settings=settings,
        strip=work.facts(),
        cycles=work.cycles,
        levels=levels,
        response=response,
        **lines,
        end_of_hold=work.end_of_hold(levels),
        modulus_kPa=modulus,
        strain_offset=offset,
        settlings=work.settlings(),
        loading=loading,
        unloading=unloading,
        stress=stress,
        relaxation=work.relaxation(),
        lowest_strain=lowest,
        residue=_make_residue_parameters(work.residue, specimen.source),
        unread=tuple(unread),
        refused=(),
        reduced=(),
    )
    return replace(
        material,
        refused=why_refused(material, disagreement, why_no_modulus),
        reduced=(*notes, *unread, *why_reduced(material, work.why_no_stress)),
    )


class _Work:
    def __init__(self, readings: list[CycleReadings], specimen: Specimen, settings: CharacterisationSettings) -> None:
        self._readings = readings
        self._specimen = specimen
        self._settings = settings
        self._steps = [step for cycle in readings for step in _steps(cycle, specimen.strip)]
        self._separated, self.residue = separate_with_residue(self._steps)
        self._stress_common, self._stress = self._fit_stress()

    @cached_property
    def cycles(self) -> tuple[CycleChange, ...]:
        local, apparent = self._changes(self._separated)
        errors = np.hypot(self._separated.level_stderr[0::2], self._values_before(self._separated.level_stderr))
        end_s = self._settings.end_s
        held_ends = [float(cycle.held[cycle.held_s > cycle.held_s[-1] - end_s].mean()) for cycle in self._readings]
        return tuple(
            CycleChange(
                load=cycle.load,
                strain=cycle.strain,
                cycle=cycle.cycle,
                apparent=float(apparent[k]),
                apparent_stderr=float(errors[k]) * self._specimen.strip.share,
                local=float(local[k]),
                local_stderr=float(errors[k]),
                from_before=(1 + held_ends[k]) / (1 + float(cycle.before.mean())) - 1,
                from_rested=held_ends[k],
                stress_kPa=None if stress is None else float(stress[0][0]),
                stress_stderr_kPa=None if stress is None else stress[1],
            )
            for k, (cycle, stress) in enumerate(zip(self._readings, self._stress, strict=True))
        )

    @property
    def why_no_stress(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(cycle.stress_why for cycle in self._readings if cycle.stress_why))

    def lines(self, levels: Sequence[StrainLevel]) -> dict[str, FittedLine]:
        used_cycles = self._select_cycles(levels)
        cycles = [self.cycles[k] for k in used_cycles]
        changes = self._changes(self._separated)
        shifted_changes = {
            name: [self._changes(variant) for variant in sets] for name, sets in self._shift_parameters().items()
        }
        lines = {}
        for name, column, error in (
            ("local", 0, [c.local_stderr for c in cycles]),
            ("apparent", 1, [c.apparent_stderr for c in cycles]),
        ):
            shifted = {
                cause: [variant[column][used_cycles].tolist() for variant in sets]
                for cause, sets in shifted_changes.items()
            }
            if name == "local":
                shifted["contacts of the pins"] = [
                    self._changes(self._separated, other=True)[0][used_cycles].tolist()
                ]
            for abscissa in ("strain", "stress"):
                key = f"local_against_{abscissa}" if name == "local" else f"against_{abscissa}"
                place = attrgetter("strain" if abscissa == "strain" else "stress_kPa")
                source = self._specimen.source
                lines[key] = fit_line(cycles, changes[column][used_cycles].tolist(), error, place, shifted, source)
        return lines

    def end_of_hold(self, levels: Sequence[StrainLevel]) -> tuple[FittedLine, FittedLine]:
        cycles = [self.cycles[k] for k in self._select_cycles(levels)]
        source = self._specimen.source
        changes = ([c.from_before for c in cycles], [c.from_rested for c in cycles])
        before, rested = (
            fit_line(cycles, values, [0.0] * len(values), attrgetter("strain"), {}, source) for values in changes
        )
        return before, rested

    def settlings(self) -> tuple[StrainSettling, ...]:
        return (
            *settlings("conductance", True, self._split_directions(True), self._settings),
            *settlings("conductance", False, self._split_directions(False), self._settings),
            *settlings("stress", True, self._split_stress(), self._settings),
        )

    def kernels(self) -> tuple[Relaxation | None, Relaxation | None, Relaxation | None]:
        source = self._specimen.source
        common = self._separated.common
        return (
            unit_kernel(common.get(True), self._split_directions(True), source),
            unit_kernel(common.get(False), self._split_directions(False), source),
            unit_kernel(self._stress_common, self._split_stress(), source),
        )

    def relaxation(self) -> StripRelaxation | None:
        return strip_relaxation(self._split_directions(True), self._split_directions(False), self._specimen.source)

    def facts(self) -> StripFacts:
        specimen, strip = self._specimen, self._specimen.strip
        share = strip.contact_squares / strip.squares
        return StripFacts(specimen.resistance_ohm, specimen.relative_noise, strip.squares, share, strip.share)

    def _select_cycles(self, levels: Sequence[StrainLevel]) -> list[int]:
        used_strains = {level.strain for level in levels if not level.why}
        return [k for k, cycle in enumerate(self.cycles) if cycle.strain in used_strains]

    def _values_before(self, of_steps: Array) -> Array:
        return np.concatenate([[0.0], of_steps[1::2]])[: len(self._readings)]

    def _changes(self, separated: SeparatedSteps, *, other: bool = False) -> tuple[Array, Array]:
        """Steady changes under the head and between the pins, and with other contacts if requested."""
        strip, levels = self._specimen.strip, separated.levels[0::2]
        levels_before = self._values_before(separated.levels)
        after_pins, before_pins = strip.apparent(levels), strip.apparent(levels_before)
        if other:
            levels, levels_before = (
                self._specimen.other_contacts.local(changes) for changes in (after_pins, before_pins)
            )
        return levels - levels_before, (after_pins - before_pins) / (1 + before_pins)

    def _shift_parameters(self) -> dict[str, list[SeparatedSteps]]:
        """The separated steps with shifted time constants and residue."""
        common_fits, local = self._separated.common, changes_of(self._separated, self._steps)
        steps = subtract_residue(self._steps, local, self.residue)
        shifted_steps = {
            "time constants": [
                separate_with_constants(steps, common_fits, shifted) for shifted in shift_constants(common_fits)
            ]
        }
        if self.residue is not None:
            faded_steps = [
                subtract_residue(self._steps, local, shifted) for shifted in self.residue.shift_parameters()
            ]
            shifted_steps["slow residue"] = [
                separate_with_constants(shifted, common_fits, constants_of(common_fits)) for shifted in faded_steps
            ]
        return shifted_steps

    def _split_directions(self, loading: bool) -> list[DirectedTrace]:
        levels_before = self._values_before(self._separated.levels)
        changes = changes_of(self._separated, self._steps)
        traces = []
        for k, cycle in enumerate(self._readings):
            step = 2 * k + (not loading)
            time_s, values = self._separated.traces[step]
            ramp_s = cycle.press_ramp_s if loading else cycle.release_ramp_s
            size = float(changes[k]) if loading else -float(changes[k])
            amplitudes = self._separated.amplitudes[step]
            traces.append(DirectedTrace(cycle.strain, (time_s, values - levels_before[k]), size, amplitudes, ramp_s))
        return [cycle for cycle in traces if len(cycle.trace[0])]

    def _fit_stress(self) -> tuple[CommonRelaxation | None, list[tuple[Array, float] | None]]:
        """The common relaxation of stress, and every cycle's fit; the unloaded head has no residue."""
        traces = [(cycle.stress_s, cycle.stress_kPa) for cycle in self._readings]
        if not any(len(time_s) for time_s, _ in traces):
            return None, [None] * len(traces)
        common = fit_common_relaxation([trace for trace in traces if len(trace[0])])
        constants_s = np.array(common.fit.time_constants_s)
        return common, [fit_step(trace, constants_s) if len(trace[0]) else None for trace in traces]

    def _split_stress(self) -> list[DirectedTrace]:
        return [
            DirectedTrace(
                cycle.strain, (cycle.stress_s, cycle.stress_kPa), float(fit[0][0]), fit[0][1:], cycle.press_ramp_s
            )
            for cycle, fit in zip(self._readings, self._stress, strict=True)
            if fit is not None
        ]


def _steps(cycle: CycleReadings, strip: StripModel) -> tuple[StepTrace, StepTrace]:
    rested = strip.local(cycle.rested)
    return (
        StepTrace(cycle.hold_start_s, True, cycle.held_s, strip.local(cycle.held)),
        StepTrace(cycle.rest_start_s, False, cycle.rested_s, rested, relaxation_start(rested)),
    )


def _make_residue_parameters(residue: SlowResidue | None, source: str) -> tuple[Parameter, Parameter] | None:
    if residue is None:
        return None
    share, log_decay = np.sqrt(np.diag(residue.covariance))
    return (
        Parameter(residue.share, float(share), source),
        Parameter(residue.decay_s, float(residue.decay_s * log_decay), source),
    )
