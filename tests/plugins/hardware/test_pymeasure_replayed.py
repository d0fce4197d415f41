"""PyMeasure's own driver of the Keithley 2600 series, over a recorded and a replayed link."""

from dataclasses import replace

import numpy as np
import pytest
from scanning_rig import TabledWorld

from cbsr_qa.domain.plan.plan import InstrumentSpec, Motion
from cbsr_qa.plugin.links.recorder import Recorder
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.transcript import Transcript
from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.source_meter import EmulatedSourceMeter
from cbsr_qa.simulate.instruments.streams import WatchedClock
from cbsr_qa.station.setup import configure
from cbsr_qa.system.clock import VirtualClock

pytest.importorskip("pymeasure", reason="PyMeasure is not installed")

from pymeasure.adapters import Adapter
from pymeasure.instruments.keithley import Keithley2600


class Resource:
    """The emulated instrument as a VISA resource."""

    def __init__(self, meter):
        self._meter, self._answers = meter, bytearray()

    def write_raw(self, data):
        self._answers += self._meter.receive(data)

    def read_raw(self):
        end = self._answers.index(b"\n") + 1
        line = bytes(self._answers[:end])
        del self._answers[:end]
        return line


class LinkAdapter(Adapter):
    """What PyMeasure's drivers write to and read from."""

    def __init__(self, link):
        super().__init__()
        self._link = link

    def _write(self, command, **_):
        self._link.write_raw(f"{command}\n".encode())

    def _read(self, **_):
        return self._link.read_raw().decode().rstrip("\n")


def measure(link):
    """Set a channel up as PyMeasure does, and read from it."""
    meter = Keithley2600(LinkAdapter(link))
    channel = meter.ChA
    channel.source_mode = "current"
    channel.compliance_voltage = 20.0
    channel.source_current = 4e-4
    channel.source_output = "ON"
    read = [channel.source_current, channel.compliance_voltage, channel.voltage, channel.current, channel.resistance]
    channel.source_output = "OFF"
    return [*read, meter.next_error]


@pytest.mark.filterwarnings("ignore:It is not known whether this device support SCPI:FutureWarning")
def test_it_reads_from_a_transcript_what_it_read_from_the_instrument(tmp_path):
    rig = EmulatedRig(WatchedClock(), TabledWorld(), Motion(40 / 60, 10.0, 25.0))
    shipped = configure("simulated", "golden-check", sensor_type=None, material=None, seed=3).station
    spec = InstrumentSpec("source_meter", "keithley-2600", ("source_meter",), {}, None)
    station, path = replace(shipped, instruments=(spec,)), tmp_path / "keithley.txt"
    meter = EmulatedSourceMeter(rig, {}, lambda data: None)
    recorder = Recorder(path, station, rig.clock)
    read = measure(recorder.connect("source_meter", lambda: Resource(meter)))
    recorder.close()
    assert read[:2] == [4e-4, 20.0]
    assert np.isfinite(read[2:5]).all()
    assert read[5][0] == 0
    replayed = Replay(Transcript.read(path), station, VirtualClock()).connect("source_meter", lambda: None)
    assert measure(replayed) == read
