"""Relaxation metrics: settling times, event rate, and agreement of image with blobs and of sheet with strip."""

from collections.abc import Iterator
from typing import ClassVar, Final

from cbsr_qa.analysis.run.agreement import DirectedAgreement, image_against_blobs, sheet_against_strip
from cbsr_qa.calibration.fits.agreement import SHAPE_MARGIN, TIME_MARGIN, Agreement
from cbsr_qa.calibration.fits.common_relaxation import common_settling_time, fit_common_relaxation
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean, relaxation_start, window_s
from cbsr_qa.calibration.fits.steady_state import event_rate_per_min
from cbsr_qa.plugin import (
    Bound,
    Dimensions,
    LoadObservation,
    Measurement,
    RelaxationObservation,
    RunObservation,
)
from cbsr_qa.report.tables import plural, with_uncertainty
from cbsr_qa_plugins.metrics._shared import measurement_of_load

#: Fewest points of a trace that are fitted.
_MIN_POINTS = 5

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

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        return tuple(_measure_settling(load, seen) for seen in load.relaxations)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Put the loads together, by signal and direction."""
        groups: dict[str, list[_Member]] = {}
        for load in run.tested:
            for seen in load.relaxations:
                groups.setdefault(_qualifier(seen), []).append((load, seen))
        means = [_mean(qualifier, [seen for _, seen in members]) for qualifier, members in groups.items()]
        return (*means, *(_common(qualifier, members, run) for qualifier, members in groups.items()))


def _qualifier(seen: RelaxationObservation) -> str:
    return Dimensions(seen.signal, "loading" if seen.loading else "unloading").text


def _measure_settling(load: LoadObservation, seen: RelaxationObservation) -> Measurement:
    time, how = seen.settling, seen.settling.why or f"{seen.fit.status}, R² {seen.fit.r_squared:.3f}"
    bound = _choose_bound(time.censored)
    return measurement_of_load(
        load, "settling_time", time.value_s, "s", qualifier=_qualifier(seen), how=how, bound=bound
    )


def _mean(qualifier: str, members: list[RelaxationObservation]) -> Measurement:
    name = "mean_settling_time"
    timed = [(m.settling.value_s, m.settling.censored) for m in members if m.settling.value_s is not None]
    late = sum(censored for _, censored in timed)
    settled = len(timed) - late
    rejected = len(members) - len(timed)
    words = [f"{settled} of {settled + late + rejected} settled"]
    words += [f"{late} later than {'its window' if late == 1 else 'their windows'}"] if late else []
    words += [f"{rejected} rejected"] if rejected else []
    how = ", ".join(words)
    if 2 * len(timed) < len(members):
        why = f"{how}: fewer than half of the loads say anything, and their mean would be one of the quick"
        return Measurement(name, None, "s", qualifier=qualifier, how=why)
    mean_s, deviation_s = estimate_restricted_mean([time for time, _ in timed], [censored for _, censored in timed])
    how += f"; standard deviation {deviation_s:.3g} s"
    how += "; a lower bound (Kaplan–Meier)" if late else ""
    term_counts = [len(m.fit.time_constants_s) for m in members if m.settling.value_s is not None]
    one_exponential = 2 * term_counts.count(1) > len(term_counts)
    how += "; one exponential a load is biased to short times" if one_exponential else ""
    stderr_s = deviation_s / len(timed) ** 0.5 if len(timed) > 1 else None
    return Measurement(name, mean_s, "s", stderr_s, qualifier=qualifier, how=how, bound=_choose_bound(late > 0))


def _common(qualifier: str, members: list[_Member], run: RunObservation) -> Measurement:
    traced = [(load, seen) for load, seen in members if len(seen.trace.values) >= _MIN_POINTS]
    starts = [0 if seen.loading else relaxation_start(seen.trace.values) for _, seen in traced]
    traces = [
        (seen.trace.time_s[start:], seen.trace.values[start:])
        for (_, seen), start in zip(traced, starts, strict=True)
    ]
    common = fit_common_relaxation(traces)
    # Where the first fit behind a spike begins; 0 where any trace has no spike.
    earliest_s = min(float(time_s[0]) for time_s, _ in traces) if starts and all(starts) else 0.0
    settling, stderr_s = common_settling_time(
        common,
        window_s=max((window_s(seen.trace.time_s) for _, seen in traced), default=1.0),
        tolerance=run.settings.settling_tolerance,
        band=run.settings.settling_band,
        loaded_change=_hold_end_change(traced),
        start_s=earliest_s,
    )
    pairs = zip(common.fit.time_constants_s, common.fit.time_constant_stderr_s, strict=True)
    constants = " and ".join(f"{with_uncertainty(tau_s, error_s)} s" for tau_s, error_s in pairs)
    how = f"{common.fit.status}, {constants}" if constants else common.fit.why
    how += f"; {common.traces} traces fitted together"
    how += f"; {settling.why}" if settling.why and settling.why != common.fit.why else ""
    name, bound = "common_settling_time", _choose_bound(settling.censored)
    return Measurement(name, settling.value_s, "s", stderr_s, qualifier=qualifier, how=how, bound=bound)


def _hold_end_change(members: list[_Member]) -> float | None:
    """Mean change at the end of the holds of unloadings; None for loadings."""
    if not members or members[0][1].loading:
        return None
    holds = [load.relaxation(released.signal, loading=True) for load, released in members]
    ends = [pressed.trace.end_level for pressed in holds if pressed is not None and len(pressed.trace.values)]
    return sum(ends) / len(ends) if ends else 0.0


def _choose_bound(late: bool) -> Bound:
    return Bound.LOWER if late else Bound.EXACT


#: Qualifier, and how much of the settling times of loading and unloading is waited for.
_WAYS: Final = (
    ("waiting", 1.5, 1.5),  # paper, 4.3.2
    ("compensated", 0.3, 1.5),  # the steady state is predicted; what a release leaves still has to fade
)


class EventRate:
    """``usable_event_rate`` [1/min] at one place, from the settling times that all loads of a run have in common.

    ``waiting``: 1.5 settling times are waited for after every press and every release, as the paper does.
    ``compensated``: 0.3 of one after a press, whose steady state is predicted, and 1.5 after a release. Where a time
    is only known to be longer than its window, the rate is at most what is said, and has no value. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"usable_event_rate": "1/min"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without both settling times there is no value."""
        common = {m.qualifier: m for m in SettlingTimes().measure_run(run) if m.name == "common_settling_time"}
        times = [common.get(f"conductance, {direction}") for direction in ("loading", "unloading")]
        return tuple(_rate(times, *way) for way in _WAYS)


def _rate(times: list[Measurement | None], qualifier: str, hold_multiple: float, rest_multiple: float) -> Measurement:
    loading, unloading = times
    why = _why_not(loading, "loading") or _why_not(unloading, "unloading")
    if why or loading is None or unloading is None or loading.value is None or unloading.value is None:
        return Measurement("usable_event_rate", None, "1/min", qualifier=qualifier, how=why)
    if loading.value + unloading.value <= 0:
        why = "the sheet settles within a frame: frames limit the rate, not the material"
        return Measurement("usable_event_rate", None, "1/min", qualifier=qualifier, how=why)
    rate = event_rate_per_min(loading.value, unloading.value, held=hold_multiple, rested=rest_multiple)
    spread_s = (
        (hold_multiple * (loading.uncertainty or 0.0)) ** 2 + (rest_multiple * (unloading.uncertainty or 0.0)) ** 2
    ) ** 0.5
    how = f"{hold_multiple:g} of {loading.value:.3g} s held, {rest_multiple:g} of {unloading.value:.3g} s rested"
    # d(60/P) = 60/P² dP
    return Measurement("usable_event_rate", rate, "1/min", rate**2 / 60 * spread_s, qualifier=qualifier, how=how)


def _why_not(time: Measurement | None, direction: str) -> str:
    if time is None:
        return f"no relaxation of {direction} was seen"
    if time.value is None:
        return f"no settling time of {direction}: {time.how}"
    return f"{direction} settles later than its window of {time.value:.3g} s" if time.bound is Bound.LOWER else ""


_WORDS = {
    Agreement.EQUIVALENT: "equivalent within",
    Agreement.DIFFERENT: "different by more than",
    Agreement.UNDECIDED: "undecided at a margin of",
}


def describe_shape(pair: DirectedAgreement) -> str:
    """Whether the curves are equivalent, and where they differ most; or why they were not compared."""
    agreement = pair.found
    if agreement.why:
        return _describe_refusal(pair)
    words = f"{_WORDS[agreement.shape]} {SHAPE_MARGIN:g} of the change: at most {agreement.shape_reach:.2g} apart"
    return f"{words}, most at {agreement.at_s:.3g} s; {plural(pair.loads, 'load')}"


def describe_time(pair: DirectedAgreement) -> str:
    """Whether the settling times are equivalent; or why they were not compared."""
    agreement = pair.found
    if agreement.why:
        return _describe_refusal(pair)
    if agreement.time_ratio is None:
        return "one of them has no settling time within its window"
    return f"{_WORDS[agreement.time]} {TIME_MARGIN:.0%} of the settling time; {plural(pair.loads, 'load')}"


def _describe_refusal(pair: DirectedAgreement) -> str:
    why = pair.found.why
    about = f" (the first is of the {pair.first})" if "the first" in why or "the second" in why else ""
    return f"not compared: {why}{about}"


class BlobAndImageRelaxation:
    """``relaxation_shape_difference`` [1] and ``relaxation_time_ratio`` [1]: image against blobs, press and release.

    The mean of the whole image is there without a mask and without a blob: if it relaxes otherwise than the blobs,
    the mask moves, or something else than the loads does. Both are fitted over all loads that show both. The first is
    the difference of the curves over the steady change (after a release over the released one) where it may be
    largest, the second that of the settling times. ``how`` says whether that is equivalent within 0.1 of the change
    and within 20 % of the time, which is tested, or different, or undecided. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"relaxation_shape_difference": "1", "relaxation_time_ratio": "1"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        names = ("relaxation_shape_difference", "relaxation_time_ratio")
        return tuple(
            measured
            for pair in image_against_blobs(run)
            for measured in _measure_agreement(
                pair, Dimensions("image against conductance", pair.direction).text, names
            )
        )


class SheetAndStripRelaxation:
    """How a sheet's loads creep and fade, against a strip of its material, after presses and after releases.

    ``strip_relaxation_difference`` [1]: the curves' difference, sheet less strip, over the steady (the released)
    change where it may be largest. ``strip_relaxation_time_ratio`` [1]: of the settling times, sheet over strip.
    ``strip_relaxation_difference_bound`` and ``strip_relaxation_time_bound`` [1]: the largest difference, and the
    largest ratio either way, that the data leave open at 5 %. A limit on these two is a test of equivalence, which no
    amount of noise passes: 0.1 and 1.2 are the margins that ``how`` states.

    The strip's relaxation is that of the material file the run was given (``cbsr-qa run --material``); without one
    nothing has a value, and ``how`` says why. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {
        "strip_relaxation_difference": "1",
        "strip_relaxation_difference_bound": "1",
        "strip_relaxation_time_ratio": "1",
        "strip_relaxation_time_bound": "1",
    }
    needs_force: ClassVar[bool] = True

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        names = ("strip_relaxation_difference", "strip_relaxation_time_ratio")
        bounds = ("strip_relaxation_difference_bound", "strip_relaxation_time_bound")
        return tuple(
            measured
            for pair in sheet_against_strip(run)
            for measured in _measure_agreement(pair, pair.direction, names, bounds)
        )


def _measure_agreement(
    pair: DirectedAgreement, qualifier: str, names: tuple[str, str], bounds: tuple[str, str] = ("", "")
) -> Iterator[Measurement]:
    """Yield difference of the curves and ratio of the times, each followed by its bound if that is measured."""
    found = pair.found
    values = (
        (found.shape_difference, found.shape_stderr, found.shape_reach, describe_shape(pair)),
        (found.time_ratio, found.time_ratio_stderr, found.time_reach, describe_time(pair)),
    )
    for name, bound, (value, stderr, reach, how) in zip(names, bounds, values, strict=True):
        yield Measurement(name, value, "1", stderr, qualifier=qualifier, how=how)
        if bound:
            yield Measurement(bound, reach, "1", qualifier=qualifier, how=how)
