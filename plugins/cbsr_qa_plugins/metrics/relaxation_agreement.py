"""Whether the blobs relax as the whole image does."""

from typing import Any, ClassVar

import numpy as np

from cbsr_qa.calibrate.common_relaxation import fit_common_relaxation
from cbsr_qa.calibrate.relaxation_agreement import MeasuredRelaxation, RelaxationAgreement, compare_relaxations
from cbsr_qa.calibrate.unloading import relaxation_start
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RelaxationObservation, RunObservation
from cbsr_qa_plugins.metrics._shared import refuse_unknown

#: Fewest points of a trace that are fitted.
_FEWEST = 5
_SHAPE_MARGIN, _TIME_MARGIN = 0.1, 0.2


class BlobAndImageRelaxation:
    """``relaxation_shape_difference`` [1] and ``relaxation_time_ratio`` [1]: image against blobs, press and release.

    The mean of the whole image is there without a mask and without a blob: if it relaxes otherwise than the blobs,
    the mask moves, or something else than the loads does. Both are fitted over all loads that show both. The first is
    the difference of the curves over the steady change (after a release over the released one) where it may be
    largest, the second that of the settling times. ``how`` says whether that is equivalent within 0.1 of the change
    and within 20 % of the time, which is tested, or different, or undecided. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"relaxation_shape_difference": "1", "relaxation_time_ratio": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("relaxation-agreement", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Compare loadings and unloadings."""
        return (*_compared(run, loading=True), *_compared(run, loading=False))


def _compared(run: RunObservation, *, loading: bool) -> tuple[Measurement, ...]:
    loads = [load for load in run.loads if all(_of(load, signal, loading) for signal in ("conductance", "image"))]
    if not loads:
        return ()
    blob, image = (_measured(loads, signal, loading) for signal in ("conductance", "image"))
    found = compare_relaxations(
        blob, image, shape_margin=_SHAPE_MARGIN, time_margin=_TIME_MARGIN, tolerance=run.settings.settling_tolerance
    )
    qualifier = f"image against conductance, {'loading' if loading else 'unloading'}"
    words = _in_words(found, len(loads))
    values = (found.shape_difference, found.shape_stderr), (found.time_ratio, found.time_ratio_stderr)
    return tuple(
        Measurement(name, value, unit, uncertainty=stderr, qualifier=qualifier, how=how)
        for (name, unit), (value, stderr), how in zip(
            BlobAndImageRelaxation.measures.items(), values, words, strict=True
        )
    )


def _in_words(found: RelaxationAgreement, loads: int) -> tuple[str, str]:
    if found.why:
        said = f"not compared: {found.why} (the first is of the blobs)"
        return said, said
    shape = f"{found.shape} within {_SHAPE_MARGIN:g} of the change: at most {found.shape_reach:.2g} apart"
    shape += f", most at {found.at_s:.3g} s; {loads} loads"
    if found.time_ratio is None:
        return shape, "one of them has no settling time within its window"
    return shape, f"{found.time} within {_TIME_MARGIN:.0%} of the settling time; {loads} loads"


def _measured(loads: list[LoadObservation], signal: str, loading: bool) -> MeasuredRelaxation:
    seen = [found for load in loads if (found := _of(load, signal, loading))]
    starts = [0 if loading else relaxation_start(one.trace.values) for one in seen]
    traces = [(one.trace.time_s[at:], one.trace.values[at:]) for one, at in zip(seen, starts, strict=True)]
    window_s = max(float(time_s[-1]) for time_s, _ in traces)
    change = None if loading else float(np.mean([_end(load, signal) for load in loads]))
    start_s = min(float(time_s[0]) for time_s, _ in traces)
    return MeasuredRelaxation(fit_common_relaxation(traces), window_s, change, start_s)


def _of(load: LoadObservation, signal: str, loading: bool) -> RelaxationObservation | None:
    """The relaxation of a signal, None where it is too short."""
    found = (seen for seen in load.relaxations if seen.signal == signal and seen.loading is loading)
    return next((seen for seen in found if len(seen.trace.values) >= _FEWEST), None)


def _end(load: LoadObservation, signal: str) -> float:
    """Level at the end of the hold."""
    held = next((seen for seen in load.relaxations if seen.signal == signal and seen.loading), None)
    return 0.0 if held is None or not len(held.trace.values) else float(np.median(held.trace.values[-4:]))
