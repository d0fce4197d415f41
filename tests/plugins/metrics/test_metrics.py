"""Every built-in metric: it exists and refuses options it does not have."""

from importlib import import_module

import pytest

from cbsr_qa.domain import ConfigError
from cbsr_qa.plugin import Kind, LoadMetric, RunMetric
from cbsr_qa_plugins.registry import BUILT_IN

METRICS = [(name, target) for kind, name, target in BUILT_IN if kind is Kind.METRIC]


@pytest.mark.parametrize(("name", "target"), METRICS)
def test_every_registered_metric_exists_and_refuses_options_it_does_not_have(name, target):
    module, _, attribute = target.partition(":")
    factory = getattr(import_module(f"cbsr_qa_plugins.{module}"), attribute)
    metric = factory()
    assert isinstance(metric, (LoadMetric, RunMetric))
    with pytest.raises(ConfigError, match=f"'{name}' has no option 'threshold'"):
        factory(threshold=3)
