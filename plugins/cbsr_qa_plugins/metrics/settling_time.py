"""Settling times of every fitted relaxation, and their means over the run."""

from typing import Any

from cbsr_qa.calibrate.settling import restricted_mean
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RelaxationObservation, RunObservation
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown


class SettlingTimes:
    """``settling_time`` [s] of each load and ``mean_settling_time`` [s] of the run.

    Qualifiers say which signal and direction, e.g. ``"conductance, loading"``. A relaxation that has not settled
    within its window has no value (a number would pass an upper limit it may break), but counts in the mean, which
    is then a lower bound and says so. It has no options.
    """

    def __init__(self, **options: Any) -> None:
        refuse_unknown("settling-time", options)

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure each relaxation of a load."""
        return tuple(_of_load(load, seen) for seen in load.relaxations)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Average over loads, by signal and direction."""
        groups: dict[str, list[RelaxationObservation]] = {}
        for load in run.loads:
            for seen in load.relaxations:
                groups.setdefault(_qualifier(seen), []).append(seen)
        return tuple(_mean(qualifier, members) for qualifier, members in groups.items())


def _qualifier(seen: RelaxationObservation) -> str:
    return f"{seen.signal}, {'loading' if seen.loading else 'unloading'}"


def _of_load(load: LoadObservation, seen: RelaxationObservation) -> Measurement:
    settling, fit = seen.settling, seen.fit
    value = None if settling.censored else settling.value_s
    how = settling.why or f"{fit.status}, R² {fit.r_squared:.3f}"
    return at_load(load, "settling_time", value, "s", qualifier=_qualifier(seen), how=how)


def _mean(qualifier: str, members: list[RelaxationObservation]) -> Measurement:
    name = "mean_settling_time"
    timed = [(m.settling.value_s, m.settling.censored) for m in members if m.settling.value_s is not None]
    rejected = len(members) - len(timed)
    if not timed:
        return Measurement(name, None, "s", qualifier=qualifier, how=f"all {rejected} relaxations were rejected")
    mean_s, deviation_s = restricted_mean([time for time, _ in timed], [censored for _, censored in timed])
    open_ended = sum(censored for _, censored in timed)
    how = f"{len(timed)} relaxations, standard deviation {deviation_s:.3g} s"
    how += f"; {open_ended} not settled within their window: a lower bound (Kaplan–Meier)" if open_ended else ""
    how += f"; {rejected} fits rejected" if rejected else ""
    stderr_s = deviation_s / len(timed) ** 0.5 if len(timed) > 1 else None
    return Measurement(name, mean_s, "s", stderr_s, qualifier=qualifier, how=how)
