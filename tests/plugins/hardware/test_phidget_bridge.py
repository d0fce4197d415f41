"""The bridge's driver against a stand-in for its library: there is no such hardware here."""

import sys
import threading
from dataclasses import replace
from enum import IntEnum
from types import ModuleType

import pytest
from simulated_setting import context

from cbsr_qa.domain.errors import ConfigError, InstrumentError, SafetyError
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.taps import use_tap
from cbsr_qa.plugin.links.transcript import Transcript
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa.testing.instruments import check_closing, check_sampler
from cbsr_qa_plugins.hardware import phidget_bridge
from cbsr_qa_plugins.hardware.phidget_bridge import open_bridge

RIG = {"scale": 4.94462e6, "offset": 70.13, "sign": -1}


class BridgeGain(IntEnum):
    """Numbers as in the library: the position in its list, not the factor."""

    BRIDGE_GAIN_1, BRIDGE_GAIN_8, BRIDGE_GAIN_16, BRIDGE_GAIN_32, BRIDGE_GAIN_64, BRIDGE_GAIN_128 = 1, 4, 5, 6, 7, 8


class PhidgetError(Exception):
    def __init__(self, code, details):
        super().__init__(details)
        self.code, self.details = code, details


class Bridge:
    """What the driver uses of VoltageRatioInput."""

    def __init__(self):
        Bridge.made = self
        self.handlers, self.set, self.opened = {}, {}, False
        self.refuses = Bridge.refuses

    made = None
    refuses = None

    def __getattr__(self, name):
        if name.startswith("setOn"):
            return lambda handler: self.handlers.__setitem__(name[5:-7], handler)
        if name.startswith("set"):
            if not self.opened and name not in ("setDeviceSerialNumber", "setChannel"):
                raise PhidgetError(0x34, "Unknown or Invalid Value: not attached")
            return lambda value: self.set.__setitem__(name[3:], value)
        raise AttributeError(name)

    def openWaitForAttachment(self, timeout_ms):
        self.timeout_ms = timeout_ms
        if self.refuses:
            raise self.refuses
        self.opened = True
        self.handlers["Attach"](self)

    def close(self):
        self.opened = False

    def getDeviceName(self):
        return "PhidgetBridge 4-Input"

    def getDeviceSerialNumber(self):
        return 324781

    def getDeviceVersion(self):
        return 102

    def says(self, *ratios):
        for ratio in ratios:
            self.handlers["VoltageRatioChange"](self, ratio)


@pytest.fixture(autouse=True)
def library(monkeypatch):
    devices, gains = ModuleType("VoltageRatioInput"), ModuleType("BridgeGain")
    devices.VoltageRatioInput, gains.BridgeGain = Bridge, BridgeGain
    monkeypatch.setitem(sys.modules, "Phidget22", ModuleType("Phidget22"))
    monkeypatch.setitem(sys.modules, "Phidget22.Devices", ModuleType("Devices"))
    monkeypatch.setitem(sys.modules, "Phidget22.Devices.VoltageRatioInput", devices)
    monkeypatch.setitem(sys.modules, "Phidget22.BridgeGain", gains)
    monkeypatch.setattr(phidget_bridge, "_preload_libusb", lambda: None)
    monkeypatch.setattr(Bridge, "refuses", None)


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def make(clock):
    made = []

    def cell(clock=clock, **options):
        told = replace(context(None, clock=clock), role="load_cell", options=RIG | options)
        made.append(open_bridge(told))
        return made[-1]

    yield cell
    for one in made:
        one.close()


def said(clock, *grams, every_s=0.125):
    """Let the bridge send these readings, as the rig's cell would."""
    for mass_g in grams:
        clock.sleep(every_s)
        Bridge.made.says((mass_g - 70.13) / 4.94462e6)


def test_it_keeps_what_samplers_promise(make, clock):
    cell = make()
    found = check_sampler(cell, clock, wait=lambda: said(clock, *[-10.0] * 16))
    assert [one.check for one in found] == ["identity", "safe state", "samples"]
    check_closing(cell, lambda: cell.samples_since(clock.now()))


def test_it_is_set_up_as_its_table_says(make):
    cell = make(device_serial=324781, channel=2, gain=64, data_interval_ms=8)
    assert Bridge.made.set == {
        "DeviceSerialNumber": 324781,
        "Channel": 2,
        "BridgeGain": BridgeGain.BRIDGE_GAIN_64,
        "DataInterval": 8,
        "VoltageRatioChangeTrigger": 0.0,
    }
    identity = cell.identity()
    assert (identity.model, identity.serial, identity.firmware) == ("PhidgetBridge 4-Input", "324781", "102")
    assert not identity.simulated


def test_ratios_become_newtons_with_compression_positive(make, clock):
    cell = make()
    said(clock, 0.0, -100.0, -749.0)
    block = cell.samples_since(-1.0)
    assert block.time_s.tolist() == [0.125, 0.25, 0.375]
    assert block.values == pytest.approx([0.0, 0.980665, 7.345181])
    assert cell.samples_since(0.25).time_s.tolist() == [0.375]


def test_a_cell_that_stands_flat_at_its_limit_is_said(make, clock):
    cell = make(limit_N=7.34)
    said(clock, -100.0, -749.0)
    assert len(cell.samples_since(-1.0)) == 2
    said(clock, -749.0)
    with pytest.raises(SafetyError, match=r"stands at its limit of 7\.34 N"):
        cell.samples_since(0.375)


class Sending(VirtualClock):
    """A clock on which the bridge sends while somebody sleeps."""

    mass_g = 12.0

    def sleep(self, duration_s):
        for _ in range(round(duration_s / 0.125)):
            super().sleep(0.125)
            Bridge.made.says((self.mass_g - 70.13) / 4.94462e6)


def test_it_is_tared_at_the_opening(make):
    clock = Sending()
    cell = make(clock=clock, tare_s=1.0)
    clock.mass_g = -88.0
    clock.sleep(0.5)
    assert cell.samples_since(1.1).values == pytest.approx([0.980665] * 4)


def test_it_is_not_tared_under_load(make):
    clock = Sending()
    clock.mass_g = -300.0
    with pytest.raises(InstrumentError, match="is not a zero"):
        make(clock=clock, tare_s=1.0)
    assert not Bridge.made.opened
    clock.mass_g = 0.0
    make(clock=clock, tare_s=1.0)  # nothing is left locked


def test_an_unplugged_bridge_is_said_and_used_again_once_it_is_back(make, clock):
    cell = make()
    said(clock, -100.0)
    Bridge.made.handlers["Detach"](Bridge.made)
    for use in (lambda: cell.samples_since(-1.0), cell.alive, cell.identity):
        with pytest.raises(InstrumentError, match=r"load_cell at phidget:any:0: the bridge is unplugged"):
            use()
    Bridge.made.set.clear()
    Bridge.made.handlers["Attach"](Bridge.made)
    assert set(Bridge.made.set) == {"BridgeGain", "DataInterval", "VoltageRatioChangeTrigger"}
    said(clock, -200.0)
    assert len(cell.samples_since(-1.0)) == 2


def test_silence_is_told_with_what_the_library_said(make, clock):
    cell = make()
    said(clock, -100.0)
    cell.alive()
    Bridge.made.handlers["Error"](Bridge.made, 0x1003, "the bridge is overrange")
    clock.sleep(3.0)
    with pytest.raises(InstrumentError, match=r"nothing for 2\.25 s; its library said: the bridge is overrange"):
        cell.alive()


def test_samples_come_from_another_thread_while_one_reads(make):
    cell = make(clock=RealClock())
    over = threading.Event()

    def send():
        while not over.is_set():
            Bridge.made.says(1e-5)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        for _ in range(200):
            block = cell.samples_since(-1.0)
            assert len(block.time_s) == len(block.values)
    finally:
        over.set()
        thread.join()


# --- what may be missing ---


def test_a_bridge_is_not_opened_where_a_transcript_answers(make, clock, monkeypatch):
    """Its library is no link: the real bridge would answer beside the recorded instruments."""
    monkeypatch.setattr(Bridge, "made", None)
    with (
        use_tap(Replay(Transcript("bench", {}, ()), None, clock)),
        pytest.raises(InstrumentError, match="transcript"),
    ):
        make()
    assert Bridge.made is None


def test_no_bridge_is_said(make, monkeypatch):
    monkeypatch.setattr(Bridge, "refuses", PhidgetError(0x3, "Operation Timed Out"))
    with pytest.raises(InstrumentError, match=r"no bridge attached within 5 s") as caught:
        make(device_serial=5)
    assert "plug it in" in caught.value.remedy
    assert Bridge.made.timeout_ms == 5000


def test_another_refusal_is_passed_on(make, monkeypatch):
    monkeypatch.setattr(Bridge, "refuses", PhidgetError(0x2, "Access Denied: another program has it"))
    with pytest.raises(InstrumentError, match="does not open: Access Denied"):
        make()


def test_a_second_cell_on_one_input_is_refused(make):
    make()
    with pytest.raises(InstrumentError, match="of this program has the same address"):
        make()


def test_without_the_library_it_says_how_to_install_it(make, monkeypatch):
    monkeypatch.setitem(sys.modules, "Phidget22.Devices.VoltageRatioInput", None)
    with pytest.raises(ConfigError, match="'load_cell' needs the library Phidget22") as caught:
        make()
    assert 'pip install "cbsr-qa[phidget]"' in caught.value.remedy


def test_without_libusb_it_says_how_to_install_it(make, monkeypatch):
    def fails():
        raise OSError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setattr(sys.modules["Phidget22.Devices.VoltageRatioInput"], "VoltageRatioInput", fails)
    with pytest.raises(ConfigError, match=r"Phidget22 finds no libusb \(libusb-1\.0\.so\.0") as caught:
        make()
    assert "apt install libusb-1.0-0" in caught.value.remedy
