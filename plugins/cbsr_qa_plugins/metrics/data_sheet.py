"""Data-sheet metrics: repeatability, nonlinearity, creep, zero return, hysteresis and preconditioning.

Terms and arithmetic are those of ISA-37.1, ISA-51.1, ISO 376 and ISO 5725-2, as each metric states.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from cbsr_qa.calibration.fits.creep_fit import (
    FROM_S,
    SIGNAL,
    STRESS,
    change_between,
    creep,
    creep_at_constant_stress,
    last_cycles,
    last_stresses,
    select_equal_holds,
    zero_return,
)
from cbsr_qa.calibration.fits.estimates import (
    FEWEST_POINTS,
    Estimate,
    best_straight_line,
    pool_deviations,
    terminal_line,
)
from cbsr_qa.calibration.fits.hysteresis_fit import LoopCurve, hysteresis, loop_curve
from cbsr_qa.calibration.sheet.characteristic import (
    Characteristic,
    characteristics,
    collect_repeated_changes,
    data_sheet_loads,
    mean_characteristic,
    repeatability,
    why_no_force,
)
from cbsr_qa.plugin import (
    Dimensions,
    LoadObservation,
    Measurement,
    NumericsError,
    PluginOptions,
    Role,
    RunObservation,
    WithOptions,
)
from cbsr_qa_plugins.metrics._shared import format_count, percent, refuse_measurement


class Repeatability:
    """``repeatability`` [% of span]: standard deviation of the sensed change within phase, place and strain, pooled.

    ISO 5725-2's repeatability standard deviation in the unit ISA-51.1 and IEC 61298-2 give repeatability in. Over all
    strains, and by strain where there are several. The span is each place's mean sensed change at the highest strain.
    It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"repeatability": "%"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        loads = data_sheet_loads(run)
        try:
            overall = repeatability(loads, run.main_mask)
        except NumericsError as error:
            return (refuse_measurement("repeatability", "%", error),)
        highest = max(load.record.load.strain for load in loads)
        cells = collect_repeated_changes(loads, run.main_mask)
        measured = [_one(overall, highest, sum(map(len, cells.values())))]
        if len(cells) > 1:
            for strain, members in cells.items():
                qualifier = Dimensions(strain=strain).text
                measured.append(_one(pool_deviations(members), highest, len(members), qualifier))
        return tuple(measured)


def _one(scatter: Estimate, highest: float, cells: int, qualifier: str = "") -> Measurement:
    again = format_count(cells, "place and strain", "places and strains")
    how = (
        f"of the place's span, its mean change at {100 * highest:g} % strain; {again} pressed again,"
        f" {format_count(scatter.degrees, 'degree')} of freedom"
    )
    return percent("repeatability", scatter, how, qualifier=qualifier)


_LINES = (
    ("", "best straight line", best_straight_line),
    ("terminal-based", "line between the ends", terminal_line),
)


class Nonlinearity:
    """``nonlinearity`` [% of span]: largest deviation of the change against stress from a straight line.

    From the best straight line (independent linearity, ISA-51.1 and IEC 61298-2), and with the qualifier
    ``terminal-based`` from the line between the lowest and the highest strain. Of the mean over the locations that
    were pressed at the most strains, and of each of them. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"nonlinearity": "%"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        loads = data_sheet_loads(run)
        curves = characteristics(loads, run.main_mask)
        try:
            scatter: float | None = repeatability(loads, run.main_mask).value
        except NumericsError:
            scatter = None
        try:
            mean = mean_characteristic(curves)
            if mean.stress_kPa is None:
                raise NumericsError(f"no stress to draw the change against: {why_no_force(loads)}")
            measured = [_fit_nonlinearity(mean, scatter, line) for line in range(len(_LINES))]
        except NumericsError as error:
            return (refuse_measurement("nonlinearity", "%", error),)
        usable_curves = [
            c for c in curves if len(c.strain) >= FEWEST_POINTS and c.stress_kPa is not None and c.span > 0
        ]
        return (*measured, *(_fit_nonlinearity(curve, scatter, 0) for curve in usable_curves))


def _fit_nonlinearity(curve: Characteristic, scatter: float | None, line: int) -> Measurement:
    assert curve.stress_kPa is not None
    qualifier, words, draw = _LINES[line]
    errors = None if scatter is None else (scatter / np.sqrt(curve.loads)).tolist()
    drawn = draw(curve.stress_kPa.tolist(), (curve.change / curve.span).tolist(), errors)
    presses = format_count(int(curve.loads.sum()), "press", "presses")
    how = (
        f"from the {words} through {len(curve.strain)} strains from {100 * curve.strain[0]:g} to"
        f" {100 * curve.strain[-1]:g} %, of the change at the highest; {presses}"
    )
    location = "" if curve.location == "mean" else curve.location
    return percent(
        "nonlinearity", Estimate(drawn.largest, drawn.stderr, 0), how, qualifier=qualifier, location=location
    )


_KINDS = ("", SIGNAL, STRESS)


class Creep(WithOptions):
    """``creep`` [% of the end value]: change of the signal from a stated time after the ramp to the end of the hold.

    ISA-51.1's change of output at constant input over a stated time. The head holds the strain, so the stress relaxes
    meanwhile: without a qualifier that has been taken out. The qualifiers ``conductance`` and ``stress`` are the
    creep of each as it was seen.

    Parameters
    ----------
    from_s : the stated time.
    """

    class Options(PluginOptions):
        from_s: Annotated[float, Field(gt=0, lt=3600)] = FROM_S

    measures: ClassVar[dict[str, str]] = {"creep": "%"}
    options: Options

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Put the holds of the commonest length together."""
        try:
            loads, hold_s = select_equal_holds(data_sheet_loads(run), lambda load: load.hold_s)
        except NumericsError as error:
            return (refuse_measurement("creep", "%", error),)
        holds = format_count(len(loads), "hold")
        how = f"from {self.options.from_s:g} s after the ramp to the end of {hold_s:g} s; {holds}"
        return tuple(self._one(kind, loads, run.settings.steady_frames, how) for kind in _KINDS)

    def _one(self, kind: str, loads: tuple[LoadObservation, ...], frames: int, how: str) -> Measurement:
        from_s = self.options.from_s
        try:
            if kind:
                return percent("creep", creep(loads, kind, from_s=from_s, frames=frames), how, qualifier=kind)
            estimate = creep_at_constant_stress(loads, from_s=from_s, frames=frames)
        except NumericsError as error:
            return refuse_measurement("creep", "%", error, qualifier=kind)
        return percent("creep", estimate, f"conductance minus stress, {how}")


class ZeroReturn:
    """``zero_return`` [% of the loaded change]: share of the conductance change that remains at the end of the rest.

    ISO 376's zero error, read at the end of the rest instead of after 30 s and taken relative to each press's own
    change. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"zero_return": "%"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Put the rests of the commonest length together."""
        try:
            loads, rest_s = select_equal_holds(
                data_sheet_loads(run), lambda load: load.record.rest_end_s - load.record.unloaded_s
            )
            estimate = zero_return(loads, frames=run.settings.steady_frames)
        except NumericsError as error:
            return (refuse_measurement("zero_return", "%", error),)
        presses = format_count(len(loads), "press", "presses")
        how = f"last frames of {rest_s:g} s of rest over the last ones of the hold; {presses}"
        return (percent("zero_return", estimate, how),)


#: Qualifier of the figure that creep is in.
_AS_READ: Final = "as read"
_NO_LOOP: Final = NumericsError(
    "no strain was reached from below and from above without lifting the head between",
    remedy='give the recipe a phase with sequence = "hysteresis-loop"',
)


class Hysteresis:
    """``hysteresis`` [% of span]: greatest difference of output between falling and rising stress (ISA-37.1).

    Of the mean over the places that were pressed in loops, and of each place where there are several. What had not
    relaxed is fitted and taken out; with the qualifier ``as read`` it is not: the same of the last frames of each
    hold, in which creep passes for hysteresis. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"hysteresis": "%"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        if not run.loops:
            return (refuse_measurement("hysteresis", "%", _NO_LOOP),)
        return (*_measure_loops(run, relaxed=True), *_measure_loops(run, relaxed=False))


def _measure_loops(run: RunObservation, *, relaxed: bool) -> list[Measurement]:
    qualifier = "" if relaxed else _AS_READ
    last_s = run.settings.steady_frames * run.frame_period_s
    try:
        curves = [loop_curve(loop, relaxed=relaxed, last_s=last_s) for loop in run.loops]
        measured = [_hysteresis(curves, relaxed, qualifier)]
    except NumericsError as error:
        return [refuse_measurement("hysteresis", "%", error, qualifier=qualifier)]
    if len(curves) > 1:
        measured += [_hysteresis([curve], relaxed, qualifier, curve.location) for curve in curves]
    return measured


def _hysteresis(curves: Sequence[LoopCurve], relaxed: bool, qualifier: str, location: str = "") -> Measurement:
    widest, first = hysteresis(curves), curves[0]
    side = "above" if widest.higher else "below"
    creep = "what had not relaxed fitted and taken out" if relaxed else "creep included"
    how = (
        f"way down {side} way up at equal stress, most at {100 * widest.strain:g} % strain, of the output at"
        f" {100 * first.strain[first.peak]:g} %; {creep}, holds of {first.hold_s:.0f} s;"
        f" {format_count(sum(curve.cycles for curve in curves), 'loop')}"
    )
    return percent("hysteresis", widest.estimate, how, qualifier=qualifier, location=location)


_NAME = "preconditioning_change"


class PreconditioningChange:
    """``preconditioning_change`` [%]: change between the last two cycles, over the last; ``preconditioning_cycles``.

    Of the conductance change at the end of the hold, counted from just before the press, and with the qualifier
    ``stress`` of the stress: of all locations together and of each. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {_NAME: "%", "preconditioning_cycles": "1"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        phases = {phase.name for phase in run.record.phases if phase.role is Role.PRECONDITIONING}
        loads = [load for load in run.loads if load.phase in phases]
        if not loads:
            none = NumericsError(
                "the recipe has no preconditioning", remedy="begin it with the sequence preconditioning"
            )
            return (refuse_measurement(_NAME, "%", none),)
        cycles = 1 + max(load.record.load.trial for load in loads)
        strain = max(load.record.load.strain for load in loads)
        frames = run.settings.steady_frames
        how = f"cycle {cycles - 1} to cycle {cycles} at {100 * strain:g} % strain"
        count = Measurement("preconditioning_cycles", float(cycles), "1", how="cycles of each location, as planned")
        return (
            count,
            *_measure_preconditioning(last_cycles(loads, frames=frames), "", how),
            *_measure_preconditioning(last_stresses(loads), "stress", how),
        )


def _measure_preconditioning(
    levels: Mapping[str, tuple[float, float]], qualifier: str, how: str
) -> tuple[Measurement, ...]:
    try:
        change = change_between(levels.values())
    except NumericsError as error:
        return (refuse_measurement(_NAME, "%", error, qualifier=qualifier),)
    each = [
        Measurement(_NAME, 100 * (after - before) / after, "%", location=place, qualifier=qualifier, how=how)
        for place, (before, after) in levels.items()
        if after > 0
    ]
    return (percent(_NAME, change, f"{how}; {format_count(len(levels), 'location')}", qualifier=qualifier), *each)
