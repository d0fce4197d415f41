"""The kit for authors of drivers: every built-in driver passes it, and drivers that break a promise do not."""

import time
from dataclasses import replace

import numpy as np
import pytest
from emulated_bench import EmulatedStation, WorldForce
from scanning_rig import Scanning
from simulated_setting import MOTION, base_scene, context, sensor_type, world
from test_ert_board_stream import Bench as Board
from test_manual_instruments import Person, told as by_hand
from test_replayed_recording import recording, told

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.plugin.instruments import ForceApplicator
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, ScriptedApplicator, ScriptedFrames, ScriptedLoadCell
from cbsr_qa.testing.instruments import (
    check_applicator,
    check_closing,
    check_frame_source,
    check_instrument,
    check_sampler,
)
from cbsr_qa.testing.scanning import check_multiplexer, check_source_meter
from cbsr_qa_plugins.hardware.manual_applicator import open_applicator as open_manual_head
from cbsr_qa_plugins.hardware.manual_samplers import open_load_cell as open_manual_cell
from cbsr_qa_plugins.hardware.marlin_applicator import open_applicator
from cbsr_qa_plugins.hardware.replayed_recording import open_replay
from cbsr_qa_plugins.hardware.serial_samplers import open_load_cell, open_thermometer
from cbsr_qa_plugins.hardware.simulated_bench import open_bench

MARLIN = {"driver": "marlin-applicator", "centre_mm": [125.0, 105.0], "hover_height_mm": 60.0, "timeout_s": 0.4}


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def station(one_world):
    made = EmulatedStation(
        one_world,
        applicator=dict(MARLIN),
        cell={"driver": "serial-load-cell"},
        thermometer={"driver": "serial-thermometer"},
    )
    yield made
    made.close()


def simulated(clock):
    return open_bench(context(base_scene(), clock=clock))


def names(done):
    assert all(one.applies and one.found for one in done)
    return [one.check for one in done]


# --- the built-in drivers ---


def test_the_simulated_bench():
    clock = VirtualClock()
    bench = simulated(clock)
    assert names(check_frame_source(bench, clock, sensor_type())) == ["identity", "safe state", "frames"]
    assert names(check_sampler(bench, clock)) == ["identity", "safe state", "samples"]
    head = check_applicator(bench, clock, MOTION)
    assert names(head) == ["identity", "safe state", "surface", "strokes", "guided", "safe while down"]
    assert "the bench is closed" in check_closing(bench, lambda: bench.acquire(1)).found


def test_a_head_that_does_not_listen_where_the_surface_is(station, monkeypatch):
    head = station.open("applicator", open_applicator)
    head.link({"force_applicator": head, "force": WorldForce(station.rig)})
    monkeypatch.setattr(type(head), "expect_surface", lambda *told: None)
    with pytest.raises(AssertionError, match=r"mm deep when told to press 0.7 mm"):
        check_applicator(head, station.clock, MOTION, depth_now_mm=lambda: -station.head.height_mm)


def test_a_replayed_recording():
    clock = VirtualClock()
    bench = open_replay(told(recording(400), clock))
    check_frame_source(bench, clock, sensor_type())
    check_sampler(bench, clock)
    check_applicator(bench, clock, MOTION)
    check_closing(bench, lambda: bench.acquire(1))


@pytest.mark.parametrize("options", [{}, {"format": "ascii", "baud": 230_400}], ids=["binary", "ascii"])
def test_the_ert_board(options):
    board = Board(**options)
    check_frame_source(board.driver, board.clock, sensor_type())
    check_closing(board.driver, lambda: board.driver.acquire(1))
    board.emulation.close()


def test_frames_scanned_by_meter_and_multiplexer():
    with Scanning() as rig:
        frames = rig.open_frames()
        check_frame_source(frames, rig.clock, sensor_type())
        assert names(check_source_meter(rig.meter, rig.clock))[-1] == "readings"
        (*_, order) = check_multiplexer(rig.multiplexer, sensor_type().pattern)
        assert order.found == "256 combinations, the drive pair steps faster"


def test_the_printer(station):
    head = station.open("applicator", open_applicator)
    head.link({"force_applicator": head, "force": WorldForce(station.rig)})
    found = check_applicator(head, station.clock, MOTION, depth_now_mm=lambda: -station.head.height_mm)
    assert names(found)[-1] == "safe while down"
    check_closing(head, lambda: head.move_to(0.0, 0.0))


def test_the_serial_load_cell_and_thermometer(station):
    cell = station.open("cell", open_load_cell)
    check_sampler(cell, station.clock)
    check_closing(cell, lambda: cell.samples_since(station.clock.now()))
    thermometer = station.open("thermometer", open_thermometer)
    check_sampler(thermometer, station.clock, within_s=30.0)
    check_closing(thermometer, lambda: thermometer.samples_since(station.clock.now()))


def test_instruments_worked_by_hand():
    """The head's safe state is not its own doing while it is down: that is said, not checked."""
    clock = VirtualClock()
    person = Person(clock)
    head = open_manual_head(by_hand("head", clock, person))
    cell = open_manual_cell(by_hand("cell", clock, person, unit="N", capacity=50))
    cell.link({"force_applicator": head})
    check_instrument(head, ForceApplicator)
    check_sampler(cell, clock, wait=head.home)


def test_the_scripted_bench_is_one_too():
    """But for its head, which moves nothing and takes no time."""
    script = Script(VirtualClock())
    check_frame_source(ScriptedFrames(script, (16, 16), 2.5), script.clock, sensor_type())
    check_sampler(ScriptedLoadCell(script, ScriptedApplicator(script)), script.clock)
    with pytest.raises(AssertionError, match=r"ScriptedApplicator presses 0\.4 mm in 0 s"):
        check_applicator(ScriptedApplicator(script), script.clock, MOTION)


# --- drivers that break a promise ---


class Spoilt:
    """A simulated bench with one promise broken."""

    def __init__(self, clock, **spoilt):
        self.clock, self.bench, self.spoilt = clock, simulated(clock), spoilt
        self.calls = dict.fromkeys(spoilt, 0)

    def __getattr__(self, name):
        own = getattr(self.__dict__["bench"], name)
        if name not in self.__dict__["spoilt"]:
            return own

        def spoilt(*arguments):
            self.calls[name] += 1
            return self.spoilt[name](self, own, *arguments)

        return spoilt


def late(seconds):
    def taken(self, own, count):
        block = own(count)
        return replace(block, time_s=block.time_s + seconds, reading_time_s=None)

    return taken


def scaled(self, own, *arguments):
    block = own(*arguments)
    return replace(block, voltages=block.voltages[:, :, :13], flags=block.flags[:, :, :13], reading_time_s=None)


FRAMES = {
    "gives frames of shape": {"acquire": scaled},
    "takes 1 frames in no time": {"acquire": lambda self, own, count: simulated(VirtualClock()).acquire(count)},
    "to a call from": {"acquire": late(5.0)},
    "takes 0 frames without a word": {"acquire": lambda self, own, count: own(max(count, 1))},
    "raises ZeroDivisionError for 0 frames": {"acquire": lambda self, own, count: own(count) if 1 / count else None},
    "is not safe within 1 s": {"safe_state": lambda self, own: time.sleep(1.5)},
    "does not reach its safe state: no": {"safe_state": lambda self, own: (_ for _ in ()).throw(ValueError("no"))},
    "says something else each time": {"identity": lambda self, own: replace(own(), serial=str(self.calls))},
    "says of itself no model": {"identity": lambda self, own: replace(own(), model=" ")},
    "which is no InstrumentIdentity": {"identity": lambda self, own: "me"},
}


@pytest.mark.parametrize("said", FRAMES)
def test_a_frame_source_that_breaks_a_promise_is_told_which(said):
    clock = VirtualClock()
    with pytest.raises(AssertionError, match=said):
        check_frame_source(Spoilt(clock, **FRAMES[said]), clock, sensor_type())


def block(times, values=None):
    times = np.array(times, dtype=float)
    return SampleBlock("force", "N", times, np.zeros_like(times) if values is None else np.array(values, dtype=float))


SAMPLES = {
    "has no sample after": lambda self, own, since_s: block([]),
    "has a last sample that is 2.1": lambda self, own, since_s: own(since_s).select_interval(
        0.0, self.clock.now() - (0.5 if self.calls["samples_since"] == 1 else 2.1)
    ),
    "when asked for those after": lambda self, own, since_s: own(since_s - 1.0),
    "not in the order of their times": lambda self, own, since_s: block(own(since_s).time_s[::-1]),
    "at 2 s": lambda self, own, since_s: block([self.clock.now() + 1.0]),
    "is not a finite number": lambda self, own, since_s: block([self.clock.now()], [np.nan]),
    "gives 'depth' in 'N'": lambda self, own, since_s: replace(own(since_s), channel="depth"),
}


@pytest.mark.parametrize("said", SAMPLES)
def test_a_sampler_that_breaks_a_promise_is_told_which(said):
    clock = VirtualClock()
    with pytest.raises(AssertionError, match=said):
        check_sampler(Spoilt(clock, samples_since=SAMPLES[said]), clock)


def lifting(self, own, depth_mm, speed_mm_s):
    self.bench.release()
    own(depth_mm, speed_mm_s)


HEADS = {
    "SPOILT finds the surface 3.0 mm below": {"find_surface": lambda self, own, x, y: own(x, y) and 3.0},
    "s to ease 0.4 mm": {"press": lifting},
    "comes up in no time": {"release": lambda self, own: None},
    "s to ease 0.4 mm at 0.667 mm/s: that is 0.6 s": {
        "press": lambda self, own, depth_mm, speed_mm_s: own(depth_mm, 100 * speed_mm_s)
    },
}


@pytest.mark.parametrize("said", HEADS)
def test_an_applicator_that_breaks_a_promise_is_told_which(said):
    clock = VirtualClock()
    with pytest.raises(AssertionError, match=said.removeprefix("SPOILT ")):
        check_applicator(Spoilt(clock, **HEADS[said]), clock, MOTION)


@pytest.mark.parametrize(
    ("broken", "said"),
    [
        ({"safe_state": lambda self, own: None}, "mm above the sheet after being made safe while it was down"),
        ({"release": lambda self, own: None}, "mm above the sheet after being released"),
        ({"press": lambda self, own, depth_mm, speed: own(depth_mm + 0.3, speed)}, "mm deep when told to press 0.4"),
    ],
)
def test_where_the_head_is_seen_it_is_held_against_what_it_was_told(station, broken, said):
    head = station.open("applicator", open_applicator)
    head.link({"force_applicator": head, "force": WorldForce(station.rig)})
    spoilt = Spoilt(VirtualClock(), **broken)
    spoilt.bench = head
    with pytest.raises(AssertionError, match=said):
        check_applicator(spoilt, station.clock, MOTION, depth_now_mm=lambda: -station.head.height_mm)


METERS = {
    "gives 0.0002 A when told 0.0001 A": {"source": lambda self, own, current_A: own(2 * current_A)},
    "measured at": {"measure": lambda self, own: replace(own(), time_s=-5.0)},
    "is at its compliance": {"measure": lambda self, own: replace(own(), compliance=True)},
    "V at currents of either sign": {"measure": lambda self, own: replace(own(), volts=1.0)},
}


@pytest.mark.parametrize("said", METERS)
def test_a_meter_that_breaks_a_promise_is_told_which(said):
    with Scanning() as rig:
        spoilt = Spoilt(VirtualClock(), **METERS[said])
        spoilt.bench = rig.open_meter()
        for property_ in ("reading_period_s", "compliance_V"):
            setattr(spoilt, property_, getattr(spoilt.bench, property_))
        with pytest.raises(AssertionError, match=said):
            check_source_meter(spoilt, rig.clock)


@pytest.mark.parametrize(
    ("order", "said"),
    [
        (lambda self, own: own()[:-1], "steps through 255 combinations; there are 256"),
        (lambda self, own: (*own(), own()[0]), "takes 257 steps for 256 combinations"),
        (
            lambda self, own: own()[self.calls["order"] :] + own()[: self.calls["order"]],
            "another order the second time",
        ),
    ],
)
def test_a_multiplexer_that_breaks_a_promise_is_told_which(order, said):
    with Scanning() as rig:
        spoilt = Spoilt(VirtualClock(), order=order)
        spoilt.bench = rig.open_multiplexer()
        with pytest.raises(AssertionError, match=said):
            check_multiplexer(spoilt, sensor_type().pattern)


def test_using_a_closed_instrument_is_at_worst_an_instrument_error():
    bench = simulated(VirtualClock())

    def raising():
        raise OSError(9, "Bad file descriptor")

    with pytest.raises(AssertionError, match="SimulatedBench raises OSError when it is used closed"):
        check_closing(bench, raising)

    def refusing():
        raise InstrumentError("frames", "here", "closed")

    assert check_closing(bench, refusing).found == "then: frames at here: closed"
