"""How many presses a minute can be told apart and measured, by how long the sheet takes to settle."""

from typing import Any, ClassVar, Final

from cbsr_qa.calibrate.steady_state import event_rate_per_min
from cbsr_qa.domain.measurement import Bound, Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import refuse_unknown
from cbsr_qa_plugins.metrics.settling_time import SettlingTimes

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

    def __init__(self, **options: Any) -> None:
        refuse_unknown("event-rate", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without both settling times there is no value."""
        common = {m.qualifier: m for m in SettlingTimes().measure_run(run) if m.name == "common_settling_time"}
        times = [common.get(f"conductance, {direction}") for direction in ("loading", "unloading")]
        return tuple(_rate(times, *way) for way in _WAYS)


def _rate(times: list[Measurement | None], qualifier: str, held: float, rested: float) -> Measurement:
    loading, unloading = times
    why = _why_not(loading, "loading") or _why_not(unloading, "unloading")
    if why or loading is None or unloading is None or loading.value is None or unloading.value is None:
        return Measurement("usable_event_rate", None, "1/min", qualifier=qualifier, how=why)
    if loading.value + unloading.value <= 0:
        why = "the sheet settles within a frame: frames limit the rate, not the material"
        return Measurement("usable_event_rate", None, "1/min", qualifier=qualifier, how=why)
    rate = event_rate_per_min(loading.value, unloading.value, held=held, rested=rested)
    spread_s = ((held * (loading.uncertainty or 0.0)) ** 2 + (rested * (unloading.uncertainty or 0.0)) ** 2) ** 0.5
    how = f"{held:g} of {loading.value:.3g} s held, {rested:g} of {unloading.value:.3g} s rested"
    # d(60/P) = 60/P² dP
    return Measurement("usable_event_rate", rate, "1/min", rate**2 / 60 * spread_s, qualifier=qualifier, how=how)


def _why_not(time: Measurement | None, direction: str) -> str:
    if time is None:
        return f"no relaxation of {direction} was seen"
    if time.value is None:
        return f"no settling time of {direction}: {time.how}"
    return f"{direction} settles later than its window of {time.value:.3g} s" if time.bound is Bound.LOWER else ""
