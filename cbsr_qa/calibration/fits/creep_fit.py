"""Creep under a hold, residue after the rest, and remaining effect of preconditioning."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.estimates import Estimate, ratio_of_sums
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import finite_numbers
from cbsr_qa.domain.results.observation import LoadObservation, Trace

#: Start of a hold's creep [s]: after the ramp's own transients, and two frames of 2.5 s.
FROM_S: Final = 5.0

SIGNAL: Final = "conductance"
STRESS: Final = "stress"


def trace_of(load: LoadObservation, signal: str, *, loading: bool) -> Trace | None:
    """Trace of a load's signal after the press or after the release; None if missing or empty."""
    relaxation = load.relaxation(signal, loading=loading)
    return None if relaxation is None or not len(relaxation.trace.values) else relaxation.trace


def end_level(trace: Trace, frames: int) -> float:
    """Mean of the last samples of a trace, at most this many. NumericsError if one is not finite."""
    return float(finite_numbers(trace.values[-frames:], f"last values of the {trace.name}").mean())


def level_at(trace: Trace, time_s: float) -> float | None:
    """Value at a time, linear between samples; None outside the trace. NumericsError if a value is not finite."""
    if not trace.time_s[0] <= time_s <= trace.time_s[-1]:
        return None
    return float(np.interp(time_s, trace.time_s, finite_numbers(trace.values, f"values of the {trace.name}")))


def select_equal_holds(
    loads: Iterable[LoadObservation], duration_s: Callable[[LoadObservation], float]
) -> tuple[tuple[LoadObservation, ...], float]:
    """Return the loads with the most common length of hold (or rest), within a second, and that time [s].

    NumericsError if there are none.
    """
    members = tuple(loads)
    counts = Counter(round(duration_s(load)) for load in members)
    if not counts:
        raise NumericsError("no location was pressed at a nominal strain by itself")
    commonest = max(counts, key=lambda length: (counts[length], length))
    return tuple(load for load in members if round(duration_s(load)) == commonest), float(commonest)


def creep(loads: Sequence[LoadObservation], signal: str, *, from_s: float, frames: int) -> Estimate:
    """Change of a signal from a stated time after the ramp to the end of the hold, over its value there.

    NumericsError if no load has such a trace over that time.

    Parameters
    ----------
    signal : name of a signal of the loads' relaxations.
    frames : number of conductance frames whose mean is the end; the stress is averaged over the same time.

    Returns
    -------
    Σ (G(end) − G(from)) / Σ G(end) over the loads, as a fraction.
    """
    changes = [_measure_creep(load, signal, from_s, frames) for load in loads]
    pairs = [pair for pair in changes if pair is not None]
    return _ratio(pairs, _describe_missing_trace(signal, from_s))


def creep_at_constant_stress(loads: Sequence[LoadObservation], *, from_s: float, frames: int) -> Estimate:
    """Creep of the conductance, corrected for that of the stress.

    Under a head at rest the stress relaxes, so that input and output change together. The input's change is
    subtracted with the sensitivity at the end, S = G(end)/σ(end): Σ [G(end) − G(from) − S (σ(end) − σ(from))] / Σ
    G(end), to first order the creep at constant stress.

    NumericsError if no load has both traces over that time.
    """
    pairs = []
    for load in loads:
        signal, stress = (_measure_creep(load, name, from_s, frames) for name in (SIGNAL, STRESS))
        if signal is None or stress is None or not stress[1] > 0:
            continue
        pairs.append((signal[0] - signal[1] * stress[0] / stress[1], signal[1]))
    missing = STRESS if any(_measure_creep(load, SIGNAL, from_s, frames) for load in loads) else SIGNAL
    return _ratio(pairs, _describe_missing_trace(missing, from_s))


def zero_return(loads: Sequence[LoadObservation], *, frames: int) -> Estimate:
    """Residue of the conductance change at the end of the rest, over the change under load.

    NumericsError if no load has frames of both.

    Returns
    -------
    Σ G(end of the rest) / Σ G(end of the hold), as a fraction; negative if the sheet returns beyond zero.
    """
    pairs = []
    for load in loads:
        loaded, rested = (trace_of(load, SIGNAL, loading=loading) for loading in (True, False))
        if loaded is not None and rested is not None:
            pairs.append((end_level(rested, frames), end_level(loaded, frames)))
    return _ratio(pairs, "no load has frames of both its hold and its rest in which anything was sensed")


def last_cycles(loads: Iterable[LoadObservation], *, frames: int) -> dict[str, tuple[float, float]]:
    """Conductance change at the end of the last cycle but one, and of the last, by location.

    Returns
    -------
    Locations at which both were sensed, in the order of their first press.
    """

    def measure_held_level(load: LoadObservation) -> float | None:
        trace = trace_of(load, SIGNAL, loading=True)
        return None if trace is None else end_level(trace, frames)

    return _pair_last_cycles(loads, measure_held_level)


def last_stresses(loads: Iterable[LoadObservation]) -> dict[str, tuple[float, float]]:
    """Stress under the head at the end of these cycles, by location [kPa]; see :func:`last_cycles`."""
    return _pair_last_cycles(loads, lambda load: load.stress_kPa)


def change_between(levels: Iterable[tuple[float, float]]) -> Estimate:
    """Change from one level to the other over the other, summed up over locations, as a fraction.

    NumericsError if there is no location.
    """
    pairs = [(after - before, after) for before, after in levels]
    return _ratio(pairs, "at no location were the last two cycles both sensed")


def _ratio(pairs: Sequence[tuple[float, float]], why_none: str) -> Estimate:
    if not pairs:
        raise NumericsError(why_none)
    return ratio_of_sums(*zip(*pairs, strict=True))


def _measure_creep(load: LoadObservation, signal: str, from_s: float, frames: int) -> tuple[float, float] | None:
    """Change of a signal from a time to the end of the hold, and its level there; None without such a trace."""
    trace, frame_trace = (trace_of(load, name, loading=True) for name in (signal, SIGNAL))
    if trace is None or (signal == STRESS and load.force_N is None):  # a cell at its limit records no true values
        return None
    early_level = level_at(trace, from_s)
    last_from_s = trace.time_s[-frames:][0] if frame_trace is None else frame_trace.time_s[-frames:][0]
    if early_level is None or not last_from_s > from_s:
        return None
    end = float(trace.values[trace.time_s >= last_from_s].mean())
    return end - early_level, end


def _describe_missing_trace(signal: str, from_s: float) -> str:
    absence = "no force is known under a hold" if signal == STRESS else "nothing was sensed under a hold"
    return f"{absence} that begins before {from_s:g} s and lasts clearly longer"


def _pair_last_cycles(
    loads: Iterable[LoadObservation], level: Callable[[LoadObservation], float | None]
) -> dict[str, tuple[float, float]]:
    places: dict[str, list[LoadObservation]] = defaultdict(list)
    for load in loads:
        places[load.record.load.label].append(load)
    pairs = {}
    for place, cycles in places.items():
        ordered = sorted(cycles, key=lambda load: load.record.load.trial)
        levels = [level(load) for load in ordered[-2:]]
        if len(levels) == 2 and levels[0] is not None and levels[1] is not None:
            pairs[place] = (levels[0], levels[1])
    return pairs
