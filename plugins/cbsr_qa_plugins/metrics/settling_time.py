"""Settling times of every fitted relaxation, their means over the run, and the one all loads have in common."""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.common_relaxation import TimedValues, common_settling_time, fit_common_relaxation
from cbsr_qa.calibrate.settling import restricted_mean
from cbsr_qa.calibrate.unloading import relaxation_start
from cbsr_qa.domain.measurement import Bound, Measurement
from cbsr_qa.domain.observation import LoadObservation, RelaxationObservation, RunObservation
from cbsr_qa.domain.relaxation import RelaxationFit
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown

#: Fewest points of a trace that are fitted.
_FEWEST = 5

#: A load with one of its relaxations.
_Member = tuple[LoadObservation, RelaxationObservation]


class SettlingTimes:
    """``settling_time`` [s] of each load; ``mean_settling_time`` and ``common_settling_time`` [s] of the run.

    Qualifiers say which signal and direction, e.g. ``"conductance, loading"``. A relaxation that has not settled
    within its window is a lower bound, its window, and so is a mean with one in it. A mean needs a time, settled or
    not, from at least half of the loads: without the rejected ones it would be a choice of the quick.

    The mean of single loads is short where a trace of two settling times does not carry a second exponential (24 s
    for 29 s in simulation). The common one is of a single fit to all traces, which share their time constants, and
    has no such bias where they carry both. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {
        "settling_time": "s",
        "mean_settling_time": "s",
        "common_settling_time": "s",
    }

    def __init__(self, **options: Any) -> None:
        refuse_unknown("settling-time", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure each relaxation of a load."""
        return tuple(_of_load(load, seen) for seen in load.relaxations)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Put the loads together, by signal and direction."""
        groups: dict[str, list[_Member]] = {}
        for load in run.tested:
            for seen in load.relaxations:
                groups.setdefault(_qualifier(seen), []).append((load, seen))
        means = [_mean(qualifier, [seen for _, seen in members]) for qualifier, members in groups.items()]
        return (*means, *(_common(qualifier, members, run) for qualifier, members in groups.items()))


def _qualifier(seen: RelaxationObservation) -> str:
    return f"{seen.signal}, {'loading' if seen.loading else 'unloading'}"


def _of_load(load: LoadObservation, seen: RelaxationObservation) -> Measurement:
    settling, fit = seen.settling, seen.fit
    how = settling.why or f"{fit.status}, R² {fit.r_squared:.3f}"
    bound = _bound(settling.censored)
    return at_load(load, "settling_time", settling.value_s, "s", qualifier=_qualifier(seen), how=how, bound=bound)


def _mean(qualifier: str, members: list[RelaxationObservation]) -> Measurement:
    name = "mean_settling_time"
    timed = [(m.settling.value_s, m.settling.censored) for m in members if m.settling.value_s is not None]
    late = sum(censored for _, censored in timed)
    how = _counts(len(timed) - late, late, len(members) - len(timed))
    if 2 * len(timed) < len(members):
        why = f"{how}: fewer than half of the loads say anything, and their mean would be one of the quick"
        return Measurement(name, None, "s", qualifier=qualifier, how=why)
    mean_s, deviation_s = restricted_mean([time for time, _ in timed], [censored for _, censored in timed])
    how += f"; standard deviation {deviation_s:.3g} s"
    how += "; a lower bound (Kaplan–Meier)" if late else ""
    how += "; one exponential a load is biased to short times" if _one_exponential(members) else ""
    stderr_s = deviation_s / len(timed) ** 0.5 if len(timed) > 1 else None
    return Measurement(name, mean_s, "s", stderr_s, qualifier=qualifier, how=how, bound=_bound(late > 0))


def _counts(settled: int, late: int, rejected: int) -> str:
    words = [f"{settled} of {settled + late + rejected} settled"]
    words += [f"{late} later than {'its window' if late == 1 else 'their windows'}"] if late else []
    words += [f"{rejected} rejected"] if rejected else []
    return ", ".join(words)


def _one_exponential(members: list[RelaxationObservation]) -> bool:
    kept = [len(m.fit.time_constants_s) for m in members if m.settling.value_s is not None]
    return 2 * kept.count(1) > len(kept)


def _common(qualifier: str, members: list[_Member], run: RunObservation) -> Measurement:
    told = [member for member in members if len(member[1].trace.values) >= _FEWEST]
    starts = [0 if seen.loading else relaxation_start(seen.trace.values) for _, seen in told]
    traces = [(s.trace.time_s[start:], s.trace.values[start:]) for (_, s), start in zip(told, starts, strict=True)]
    common = fit_common_relaxation(traces)
    settling, stderr_s = common_settling_time(
        common,
        window_s=max((_window_s(seen.trace.time_s) for _, seen in told), default=1.0),
        tolerance=run.settings.settling_tolerance,
        band=run.settings.settling_band,
        loaded_change=_loaded_change(told),
        start_s=_earliest_s(traces, starts),
    )
    how = f"{_in_words(common.fit)}; {common.traces} traces fitted together"
    how += f"; {settling.why}" if settling.why and settling.why != common.fit.why else ""
    return Measurement(
        "common_settling_time",
        settling.value_s,
        "s",
        stderr_s,
        qualifier=qualifier,
        how=how,
        bound=_bound(settling.censored),
    )


def _earliest_s(traces: list[TimedValues], starts: list[int]) -> float:
    """Where the first fit behind a spike begins; 0 where any trace has no spike."""
    return min(float(time_s[0]) for time_s, _ in traces) if starts and all(starts) else 0.0


def _loaded_change(members: list[_Member]) -> float | None:
    """Mean change at the end of the holds of unloadings; None for loadings."""
    if not members or members[0][1].loading:
        return None
    held = [seen for load, one in members for seen in load.relaxations if seen.loading and seen.signal == one.signal]
    ends = [float(np.median(seen.trace.values[-4:])) for seen in held if len(seen.trace.values)]
    return sum(ends) / len(ends) if ends else 0.0


def _in_words(fit: RelaxationFit) -> str:
    pairs = zip(fit.time_constants_s, fit.time_constant_stderr_s, strict=True)
    constants = " and ".join(f"{tau:.3g} ± {stderr:.2g} s" for tau, stderr in pairs)
    return f"{fit.status}, {constants}" if constants else fit.why


def _window_s(time_s: NDArray[np.float64]) -> float:
    """Length of the observed window: half a frame beyond the last frame's middle."""
    return float(time_s[-1] + np.median(np.diff(time_s)) / 2)


def _bound(late: bool) -> Bound:
    return Bound.LOWER if late else Bound.EXACT
