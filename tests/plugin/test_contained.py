"""A plugin that ends the program, or raises what nobody expects, has failed by its name; the user's stop has not."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from simulated_setting import HEAD, material, scene, sensor_type

from cbsr_qa.domain.errors import PluginError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.plan.steps import Press, Release
from cbsr_qa.domain.plan.world import Moment, SceneSetting
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.chain import build_chain
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import schedule
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.system.words import describe_error
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench, raising


class _Escape(BaseException):
    """Nobody's error."""


def _raiser(error):
    def act(*given, **named):
        raise error

    return act


def _factory(act):
    plugins = SimpleNamespace(factory=lambda kind, name: act)
    create_plugin(plugins, Kind.METRIC, PluginChoice("theirs"), "[metrics]")


def _sequence(act):
    plan = example_plan([])
    theirs = SimpleNamespace(steps=lambda context: (act() for _ in "x"))
    schedule(replace(plan, phases=(replace(plan.phases[0], sequence=theirs),)))


def _effect(act):
    effect = SimpleNamespace(perturbs="force", needs=(), apply=act)
    setting = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)
    chain = build_chain(scene("theirs"), setting, lambda name: lambda setting: effect)
    chain.apply("force", Moment(setting, 12.5, 0, [], [0.1], [1.0]))


def _identity(act):
    bench = make_scripted_bench(Script(VirtualClock()), example_plan([]).sensor_type)
    bench.mounted[0].instrument.identity = act
    Bench.identities(bench)


#: Where a plugin's code is entered → what is blamed.
_PLACES = {
    _factory: r"\[metrics\]: metric 'theirs' failed: ",
    _sequence: "sequence 'fixed' of phase 'phase 0' failed: ",
    _effect: "effect 'theirs' failed at 12.5 s: ",
    _identity: "instrument .* failed: ",
}


@pytest.mark.parametrize("error", [SystemExit(0), _Escape("gone"), OSError("no such thing")], ids=repr)
@pytest.mark.parametrize("place", _PLACES)
def test_what_a_plugin_raises_is_its_failure(place, error):
    with pytest.raises(PluginError, match=f"{_PLACES[place]}{type(error).__name__}: {error}"):
        place(_raiser(error))


@pytest.mark.parametrize("place", _PLACES)
def test_ctrl_c_in_a_plugins_code_is_the_users(place):
    with pytest.raises(KeyboardInterrupt):
        place(_raiser(KeyboardInterrupt()))


@pytest.mark.parametrize("error", [SystemExit(0), _Escape("gone")], ids=repr)
def test_a_driver_that_leaves_breaks_the_run_by_its_name(error):
    script = Script(VirtualClock())
    script.do_at(8, raising(error))
    plan = example_plan((Press(Load("L0", 0.0, 0.0, 0.2, 0)), Release()))
    bench = make_scripted_bench(script, plan.sensor_type)
    ended = execute(plan, example_identity(), bench, script.clock, [lambda event: None], tell=lambda line: None)
    assert ended.end is EndReason.BROKEN
    assert f"failed: {type(error).__name__}: {error}, while" in ended.detail


def test_what_plugins_print_of_themselves_is_made_plain_and_short():
    assert describe_error(ValueError("a\0\x1b[2J" + "x" * 1000)) == "ValueError: a\ufffd\ufffd[2J" + "x" * 482 + "…"

    class Mute(Exception):
        def __str__(self):
            raise SystemExit

    with pytest.raises(PluginError, match="theirs failed: Mute"), blame_plugin("theirs"):
        raise Mute


def test_errors_on_purpose_pass_as_they_are():
    with pytest.raises(RefusedError, match=r"^no$") as raised, blame_plugin("theirs"):
        raise RefusedError("no")
    assert type(raised.value) is RefusedError


def test_nothing_a_plugin_raises_at_the_door_ends_the_program():
    class Leaving:
        def load(self):
            raise SystemExit(0)

    plugins = Plugins()
    plugins.add(SimpleNamespace(cbsr_register=_raiser(_Escape())), "theirs", "1", "x")
    assert plugins.failures[0].reason.startswith("_Escape")
    point = SimpleNamespace(name="x", dist=None, load=Leaving().load)
    assert [failure.reason for failure in discover(found=[point]).failures] == ["SystemExit: 0"]
