"""How far the output on the way down lies from that on the way up, at the same stress."""

from collections.abc import Sequence
from typing import Any, ClassVar, Final

from cbsr_qa.calibrate.hysteresis import LoopCurve, hysteresis, loop_curve
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown

#: Qualifier of the figure that creep is in.
_READ: Final = "as read"
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

    def __init__(self, **options: Any) -> None:
        refuse_unknown("hysteresis", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Compare the branches of all loops."""
        if not run.loops:
            return (refused("hysteresis", "%", _NO_LOOP),)
        return (*_measured(run, relaxed=True), *_measured(run, relaxed=False))


def _measured(run: RunObservation, *, relaxed: bool) -> list[Measurement]:
    qualifier = "" if relaxed else _READ
    last_s = run.settings.steady_frames * run.frame_period_s
    try:
        curves = [loop_curve(loop, relaxed=relaxed, last_s=last_s) for loop in run.loops]
        found = [_one(curves, relaxed, qualifier)]
    except NumericsError as error:
        return [refused("hysteresis", "%", error, qualifier=qualifier)]
    if len(curves) > 1:
        found += [_one([curve], relaxed, qualifier, curve.location) for curve in curves]
    return found


def _one(curves: Sequence[LoopCurve], relaxed: bool, qualifier: str, location: str = "") -> Measurement:
    found, first = hysteresis(curves), curves[0]
    side = "above" if found.higher else "below"
    creep = "what had not relaxed fitted and taken out" if relaxed else "creep included"
    how = (
        f"way down {side} way up at equal stress, most at {100 * found.strain:g} % strain, of the output at"
        f" {100 * first.strain[first.peak]:g} %; {creep}, holds of {first.hold_s:.0f} s;"
        f" {counted(sum(curve.cycles for curve in curves), 'loop')}"
    )
    return percent("hysteresis", found.estimate, how, qualifier=qualifier, location=location)
