"""Observations to judged measurements: asks every metric, then holds the answers against the recipe's limits."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from cbsr_qa.analysis.answers import answered
from cbsr_qa.domain.contained import failure
from cbsr_qa.domain.measurement import Limit, Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.outcome import SEVERITY
from cbsr_qa.interfaces import LoadMetric, RunMetric


def measure_run(
    observation: RunObservation, metrics: Mapping[str, LoadMetric | RunMetric]
) -> tuple[tuple[Measurement, ...], tuple[str, ...]]:
    """Ask every metric.

    Parameters
    ----------
    metrics : plugin name → object, in the recipe's order.

    Returns
    -------
    The measurements in that order, and a warning for every metric that failed: one that raises, or answers with what
    is no measurement, takes nothing else down, and a limit on it then finds nothing measured.
    """
    taken: list[Measurement] = []
    warnings: list[str] = []
    for name, metric in metrics.items():
        try:
            taken += ask(metric, observation)
        except BaseException as error:  # noqa: BLE001 - a stranger's code may raise anything
            warnings.append(f"metric {name} failed and measured nothing: {failure(error)}")
    return tuple(taken), tuple(warnings)


def judge(measurements: Iterable[Measurement], limits: Iterable[Limit]) -> tuple[Measurement, ...]:
    """Hold measurements against limits; the strictest outcome counts where several limits fit one measurement.

    Returns
    -------
    Every measurement, judged where a limit fits, and one without value for each limit that found nothing to judge,
    or only in another unit: a limit in µm says nothing about millimetres, and the run is kept all the same.
    """
    judged = list(measurements)
    for limit in limits:
        fitting = [number for number, measurement in enumerate(judged) if _fits(limit, measurement)]
        same_unit = [number for number in fitting if judged[number].unit == limit.unit]
        for number in same_unit:
            judged[number] = _stricter(judged[number], judged[number].judged(limit))
        if not fitting:
            judged.append(_unmeasured(limit, "no metric of this recipe measured it: enable one, or remove the limit"))
        elif not same_unit:
            found = judged[fitting[0]].unit
            judged.append(_unmeasured(limit, f"the limit is in {limit.unit}, the measurement in {found}"))
    return tuple(judged)


def ask(metric: LoadMetric | RunMetric, observation: RunObservation) -> list[Measurement]:
    """Ask one metric about every load and the whole run; errors as of :func:`answered` and the metric's own."""
    taken: list[Measurement] = []
    if isinstance(metric, LoadMetric):
        for load in observation.loads:
            taken += answered(metric.measure_load(load, observation))
            if load.alternate is not None:
                taken += _other_reference(metric, load.alternate, observation)
    if isinstance(metric, RunMetric):
        taken += answered(metric.measure_run(observation))
    return taken


def _other_reference(metric: LoadMetric, load: LoadObservation, run: RunObservation) -> list[Measurement]:
    """Measure a load against the reference the recipe did not choose; never judged, only reported beside."""
    other = "before the press" if run.settings.reference == "run" else "unloaded run"
    return [
        replace(m, qualifier=f"{m.qualifier}, reference {other}".removeprefix(", "))
        for m in answered(metric.measure_load(load, run))
    ]


def _fits(limit: Limit, measurement: Measurement) -> bool:
    return (
        limit.measurement == measurement.name
        and limit.phase in ("", measurement.phase)
        and limit.qualifier == measurement.qualifier
    )


def _stricter(before: Measurement, after: Measurement) -> Measurement:
    return before if SEVERITY.index(before.outcome) < SEVERITY.index(after.outcome) else after


def _unmeasured(limit: Limit, why: str) -> Measurement:
    nothing = Measurement(limit.measurement, None, limit.unit, phase=limit.phase, qualifier=limit.qualifier, how=why)
    return nothing.judged(limit)
