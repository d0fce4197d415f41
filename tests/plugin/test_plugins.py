"""The plugin door: lazy, named failures, nothing else taken down."""

import subprocess
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import pytest

from cbsr_qa.domain.errors import AbortedError, PluginError
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind, hookimpl


class _Stranger:
    """A plugin that registers what it is told to."""

    def __init__(self, *registrations):
        self._registrations = registrations

    @hookimpl
    def cbsr_register(self, register):
        for registration in self._registrations:
            register(*registration)


def test_every_built_in_target_can_be_imported():
    plugins = discover()
    assert plugins.failures == []
    for registration in plugins.registrations():
        assert callable(plugins.factory(registration.kind, registration.name)), registration


def test_discovery_imports_no_plugin_module():
    script = (
        "import sys; from cbsr_qa.plugin.discovery import discover; discover();"
        "print([m for m in sys.modules if m.startswith('cbsr_qa_plugins.') and m.count('.') > 1])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_importing_the_package_loads_nothing_heavy():
    script = (
        "import sys, cbsr_qa;"
        "print(sorted({'scipy', 'numpy', 'sqlalchemy', 'matplotlib', 'cbsr_qa_plugins'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_unknown_name_offers_the_nearest():
    with pytest.raises(PluginError, match="did you mean 'area-overlap'"):
        discover().factory(Kind.METRIC, "area-overlapp")


def test_a_plugin_that_cannot_be_imported_is_named_and_the_rest_stays():
    broken = EntryPoint("broken", "no_such_module_anywhere", "cbsr_qa")
    built_in = EntryPoint("built-in", "cbsr_qa_plugins.registry", "cbsr_qa")
    plugins = discover(found=[broken, built_in])
    assert [f.entry_point for f in plugins.failures] == ["broken"]
    assert "no_such_module_anywhere" in plugins.failures[0].reason
    assert "gauss-newton-noser" in plugins.names(Kind.RECONSTRUCTION)


def test_a_name_taken_twice_fails_the_later_plugin_whole():
    plugins = Plugins()
    plugins.add(_Stranger((Kind.METRIC, "weight", "a:b")), "first", "1", "x")
    plugins.add(_Stranger((Kind.METRIC, "colour", "c:d"), (Kind.METRIC, "weight", "e:f")), "second", "1", "x")
    assert plugins.names(Kind.METRIC) == ("weight",)
    assert "already registered by first" in plugins.failures[0].reason


@pytest.mark.parametrize("registration", [("no-kind", "a", "b:c"), (Kind.METRIC, "a", "no-colon")])
def test_a_malformed_registration_is_a_named_failure(registration):
    plugins = Plugins()
    plugins.add(_Stranger(registration), "odd", "1", "x")
    assert plugins.registrations() == ()
    assert plugins.failures[0].distribution == "odd"


def test_a_module_that_breaks_on_use_says_whose_it_is():
    plugins = Plugins()
    plugins.add(_Stranger((Kind.METRIC, "gone", "no_such_module_anywhere:f")), "stranger", "1", "x")
    with pytest.raises(PluginError, match="of stranger cannot be loaded"):
        plugins.factory(Kind.METRIC, "gone")


class _Listening:
    def __init__(self, heard, fails):
        self._heard, self._fails = heard, fails

    @hookimpl
    def cbsr_phase_finished(self, phase):
        if self._fails:
            raise RuntimeError("deaf")
        self._heard.append(phase)


def test_a_hook_that_fails_silences_no_other():
    heard, warnings = [], []
    plugins = Plugins()
    for number, fails in enumerate([False, True, False]):
        plugins.add(_Listening(heard, fails), f"d{number}", "1", "x")
    plugins.tell("cbsr_phase_finished", warnings.append, identity=None, phase="grid")
    assert heard == ["grid", "grid"]
    assert len(warnings) == 1
    assert "d1" in warnings[0]
    assert "deaf" in warnings[0]


def test_a_hook_may_stop_the_run_where_there_is_one():
    class Stopping:
        @hookimpl
        def cbsr_phase_finished(self, phase):
            raise AbortedError("the plugin climate-watch")

    plugins, warnings = Plugins(), []
    plugins.add(Stopping(), "climate", "1", "x")
    plugins.tell("cbsr_phase_finished", warnings.append, identity=None, phase="grid")
    assert len(warnings) == 1
    with pytest.raises(AbortedError, match="climate-watch"):
        plugins.tell("cbsr_phase_finished", warnings.append, may_abort=True, identity=None, phase="grid")


def test_order_of_discovery_changes_nothing():
    one = SimpleNamespace(cbsr_register=_Stranger((Kind.METRIC, "b", "m:b")).cbsr_register)
    two = SimpleNamespace(cbsr_register=_Stranger((Kind.METRIC, "a", "m:a")).cbsr_register)
    lists = []
    for order in ([one, two], [two, one]):
        plugins = Plugins()
        for number, plugin in enumerate(order):
            plugins.add(plugin, f"d{number}", "1", "x")
        lists.append(plugins.names(Kind.METRIC))
    assert lists[0] == lists[1] == ("a", "b")
