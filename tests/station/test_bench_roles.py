"""Roles of a bench that is put together from several instruments: meters, scanners, heads that say where they are."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.plan.plan import EMULATED, InstrumentSpec
from cbsr_qa.domain.plan.steps import Hold
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.run.events import SamplesTaken
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.instruments import MeterReading
from cbsr_qa.station.bench import Bench, Mounted, open_bench
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import VirtualClock
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
    one.source = lambda current_A: script.record_call("source_meter.source", current_A)
    one.off = lambda: script.record_call("source_meter.off")
    one.measure = lambda: MeterReading(1.0, 1e-3, False, False, script.clock.now())
    return one


def multiplexer(script):
    one = ScriptedInstrument("multiplexer", script)
    one.order = lambda: ((0, 0),)
    one.start = lambda: script.record_call("multiplexer.start")
    one.step = lambda: script.record_call("multiplexer.step")
    one.position = lambda: 0
    return one


class Scanner(ScriptedFrames):
    """Frames that need a meter and a multiplexer."""

    def link(self, peers):
        self.script.record_call("frame_source.link")
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
    assert script.count("force_applicator.safe_state") == 2  # at the start and at the end, and once each
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
    with pytest.raises(ConfigError, match=rf"impostor \(scripted\) is configured to provide '{role}'") as refused:
        Bench([*mounted, impostor])
    assert lacks in refused.value.reason


def test_an_emulated_instrument_is_simulated_whatever_it_says_and_so_is_what_works_through_it():
    script = Script(VirtualClock())
    mounted = parts(script)
    for one in mounted:
        one.instrument.simulated = False
    said = {one.role: one.simulated for one in Bench(mounted).identities()}
    assert said == {"head": False, "scanner": True, "smu": True, "mux": False, "cell": False}


# --- who is there ----------------------------------------------------------------------------------------


class Told(ScriptedInstrument):
    """One that says who it is."""

    def __init__(self, model, serial):
        super().__init__("source_meter", Script(VirtualClock()))
        self.said = InstrumentIdentity("source_meter", "scripted", model, serial, "3.2.1", simulated=False)

    def identity(self):
        return self.said


def identified(says_model, says_serial, **expected):
    script = Script(VirtualClock())
    mounted = [one for one in parts(script) if one.spec.role != "smu"]
    one = meter(script)
    one.identity = Told(says_model, says_serial).identity
    told = replace(spec("smu", "source_meter", address="TCPIP::10.0.0.7::5025::SOCKET"), **expected)
    return Bench([*mounted, Mounted(told, one)]).identities()


@pytest.mark.parametrize(
    "expected",
    [
        {},
        {"model": "2634B"},
        {"model": "model 2634b"},
        {"model": "Instruments Inc., Model 2634B"},
        {"serial": "4031823"},
        {"model": "Keithley Instruments Inc. Model 2634B", "serial": " 4031823 "},
    ],
)
def test_an_instrument_that_is_who_the_station_file_says_is_accepted(expected):
    said = identified("Keithley Instruments Inc. Model 2634B", "4031823", **expected)
    assert said[-1].model == "Keithley Instruments Inc. Model 2634B"


@pytest.mark.parametrize(
    ("expected", "said"),
    [
        ({"model": "2636B"}, "its model is 'Keithley Model 2634B'; the station file expects '2636B'"),
        ({"model": "2634"}, "the station file expects '2634'"),
        ({"model": "2634B Keithley"}, "the station file expects '2634B Keithley'"),
        ({"model": "2634B", "serial": "403"}, "its serial is '4031823'; the station file expects '403'"),
    ],
)
def test_another_instrument_at_the_address_is_refused_with_role_address_found_and_expected(expected, said):
    with pytest.raises(InstrumentError) as refused:
        identified("Keithley Model 2634B", "4031823", **expected)
    assert refused.value.reason.startswith("smu at TCPIP::10.0.0.7::5025::SOCKET: ")
    assert said in refused.value.reason
    assert not refused.value.retryable
    assert "correct address or" in refused.value.remedy


# --- who is made safe first ------------------------------------------------------------------------------


def test_the_head_is_made_safe_first_then_what_drives_current_whatever_the_files_order():
    script = Script(VirtualClock())
    Bench(reversed(parts(script))).safe_state()
    order = [name.partition(".")[0] for name in script.names() if name.endswith("safe_state")]
    assert order[:3] == ["force_applicator", "source_meter", "frame_source"]
    assert sorted(order[3:]) == ["load_cell", "multiplexer"]


def test_four_that_hang_keep_the_head_down_for_no_longer_than_one_call():
    script, never = Script(VirtualClock()), threading.Event()
    for role in ("source_meter", "frame_source", "load_cell", "multiplexer"):
        script.on(f"{role}.safe_state", lambda: never.wait(30))
    mounted = list(reversed(parts(script)))
    began = time.monotonic()
    failed = Bench(mounted, stop_within_s=0.6).safe_state()
    never.set()
    assert len(failed) == 4
    assert script.names()[1] == "force_applicator.safe_state"  # after the link
    assert time.monotonic() - began < 15
