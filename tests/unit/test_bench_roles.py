"""Roles of a bench that is put together from several instruments: meters, scanners, heads that say where they are."""

import numpy as np
import pytest

from cbsr_qa.clock import VirtualClock
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.frames import SampleBlock
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.plan import EMULATED, InstrumentSpec
from cbsr_qa.domain.run_events import SamplesTaken
from cbsr_qa.domain.steps import Hold
from cbsr_qa.interfaces import MeterReading
from cbsr_qa.runner.bench import Bench, Mounted, open_bench
from cbsr_qa.runner.execute import execute
from cbsr_qa.testing.bench import (
    Script,
    ScriptedApplicator,
    ScriptedFrames,
    ScriptedInstrument,
    ScriptedLoadCell,
    example_identity,
    example_plan,
)

PLAN = example_plan((Hold(60, acquire=True),))


def meter(script):
    one = ScriptedInstrument("source_meter", script)
    one.reading_period_s, one.compliance_V = 0.01, 20.0
    one.source = lambda current_A: script.called("source_meter.source", current_A)
    one.off = lambda: script.called("source_meter.off")
    one.measure = lambda: MeterReading(1.0, 1e-3, False, False, script.clock.now())
    return one


def multiplexer(script):
    one = ScriptedInstrument("multiplexer", script)
    one.order = lambda: ((0, 0),)
    one.start = lambda: script.called("multiplexer.start")
    one.step = lambda: script.called("multiplexer.step")
    one.position = lambda: 0
    return one


class Scanner(ScriptedFrames):
    """Frames that need a meter and a multiplexer."""

    def link(self, peers):
        self.script.called("frame_source.link")
        if "source_meter" not in peers:
            raise ConfigError("it needs a source_meter", remedy="name one in the station file")
        self.peers = dict(peers)


class TellingHead(ScriptedApplicator):
    """A head that is asked where it is, beside being moved."""

    channel, unit = "head depth", "mm"

    def samples_since(self, time_s):
        now_s = self.script.clock.now()
        times = np.array([now_s] if now_s > time_s else [])
        return SampleBlock(self.channel, self.unit, times, np.full(times.shape, -25.0))


def spec(role, *provides, **options):
    return InstrumentSpec(role, "scripted", provides or (role,), options, None)


def parts(script):
    """Role of the table → its spec and its instrument."""
    head = TellingHead(script)
    scanner = Scanner(script, PLAN.sensor_type.pattern.shape, 2.5)
    return [
        Mounted(spec("head", "force_applicator", "head_depth"), head),
        Mounted(spec("scanner", "frame_source"), scanner),
        Mounted(spec("smu", "source_meter", address=EMULATED), meter(script)),
        Mounted(spec("mux", "multiplexer"), multiplexer(script)),
        Mounted(spec("cell", "force"), ScriptedLoadCell(script, head)),
    ]


def test_a_head_that_says_where_it_is_fills_two_roles():
    script = Script(VirtualClock())
    bench = Bench(parts(script))
    told = []
    ended = execute(PLAN, example_identity(), bench, script.clock, [told.append])
    assert ended.end is EndReason.FINISHED
    channels = {d.samples.channel for d in told if isinstance(d, SamplesTaken)}
    assert channels == {"force", "head depth"}
    assert script.count("force_applicator.safe_state") == 1  # one object is told once
    assert [one.role for one in bench.identities()] == ["head", "scanner", "smu", "mux", "cell"]


def test_meter_and_multiplexer_are_no_samplers():
    bench = Bench(parts(Script(VirtualClock())))
    assert sorted(one.channel for one in bench.samplers) == ["force", "head depth"]


def test_an_instrument_that_needs_others_is_given_all_of_them_once_by_role():
    script = Script(VirtualClock())
    bench = Bench(parts(script))
    assert script.count("frame_source.link") == 1
    by_role = {role: one.instrument for one in bench.mounted for role in one.spec.provides}
    assert bench.frame_source.peers == by_role
    assert set(by_role) == {
        "force_applicator", "head_depth", "frame_source", "source_meter", "multiplexer", "force"
    }  # fmt: skip


def test_one_that_does_not_find_what_it_needs_is_named_and_everything_is_closed():
    script = Script(VirtualClock())
    without = [one for one in parts(script) if one.spec.role != "smu"]
    by_role = {one.spec.role: one.instrument for one in without}
    closed = []
    with pytest.raises(ConfigError, match=r"instrument scanner \(scripted\): it needs a source_meter") as refused:
        open_bench(
            [one.spec for one in without], lambda one: by_role[one.role], after=[("world", lambda: closed.append(1))]
        )
    assert refused.value.remedy == "name one in the station file"
    assert closed == [1]
    for role in ("force_applicator", "frame_source", "multiplexer", "load_cell"):
        assert script.count(f"{role}.close") == 1


@pytest.mark.parametrize(("role", "lacks"), [("source_meter", "compliance_V"), ("multiplexer", "order")])
def test_what_fills_the_role_of_a_meter_or_a_multiplexer_must_be_one(role, lacks):
    script = Script(VirtualClock())
    mounted = [one for one in parts(script) if role not in one.spec.provides]
    impostor = Mounted(spec("impostor", role), ScriptedLoadCell(script, ScriptedApplicator(script)))
    with pytest.raises(ConfigError, match=rf"impostor \(scripted\) is said to provide '{role}'") as refused:
        Bench([*mounted, impostor])
    assert lacks in refused.value.reason


def test_an_emulated_instrument_is_simulated_whatever_it_says():
    script = Script(VirtualClock())
    mounted = parts(script)
    for one in mounted:
        one.instrument.simulated = False
    said = {one.role: one.simulated for one in Bench(mounted).identities()}
    assert said == {"head": False, "scanner": False, "smu": True, "mux": False, "cell": False}
