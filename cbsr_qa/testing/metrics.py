"""Conformance of metrics: their answers are those a run would take."""

from cbsr_qa.analysis import ask
from cbsr_qa.domain.results import Measurement, RunObservation
from cbsr_qa.plugin import LoadMetric, RunMetric


def check_metric(metric: LoadMetric | RunMetric, observation: RunObservation) -> list[Measurement]:
    """Ask a metric as a run does, and compare with what it says it ``measures``, where it does.

    Returns
    -------
    The measurements as a run would store them.

    Raises
    ------
    PluginError
        If an answer could not be stored; names measurement and field.
    AssertionError
        If a measurement has another name or unit than the metric says.
    """
    assert isinstance(metric, LoadMetric | RunMetric), "a metric has measure_load or measure_run"
    taken = ask(metric, observation)
    said = getattr(metric, "measures", None)
    for one in taken:
        assert said is None or said.get(one.name) == one.unit, f"{one.name} in {one.unit} is not among {said}"
    return taken
