"""A plugin that does what no plugin should, where and what the environment says: HOSTILE="place: python code"."""

import os

from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.plugin.hooks import Kind, hookimpl


def _act(place):
    where, _, code = os.environ.get("HOSTILE", "").partition(": ")
    if where == place:
        exec(code, {"os": os})


@hookimpl
def cbsr_register(register):
    _act("register")
    register(Kind.METRIC, "hostile", "hostile_plugin:Metric")


@hookimpl
def cbsr_phase_finished(phase):
    _act("measuring")


class Metric:
    measures = {"hostility": "1"}  # noqa: RUF012

    def __init__(self):
        _act("factory")

    def measure_run(self, run):
        _act("metric")
        return (Measurement("hostility", 1.0, "1"),)


_act("import")
