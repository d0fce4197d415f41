"""Every built-in metric: it exists and says what it measures."""

from importlib import import_module

import pytest

from cbsr_qa.plugin import Kind, LoadMetric, RunMetric
from cbsr_qa_plugins.registry import BUILT_IN

METRICS = [(name, target) for kind, name, target in BUILT_IN if kind is Kind.METRIC]


@pytest.mark.parametrize(("name", "target"), METRICS)
def test_every_registered_metric_exists_and_says_what_it_measures(name, target):
    module, _, attribute = target.partition(":")
    factory = getattr(import_module(f"cbsr_qa_plugins.{module}"), attribute)
    metric = factory()
    assert isinstance(metric, (LoadMetric, RunMetric))
    assert factory.measures
