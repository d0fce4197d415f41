"""A rig whose readings are known: meter and multiplexer emulated over their streams, the sheet a table of ohms."""

import numpy as np

from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.plan.plan import EMULATED, InstrumentSpec, Motion
from cbsr_qa.domain.plan.world import SceneSetting
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.simulate.frames import SimulatedFrame
from cbsr_qa.simulate.instruments.rig import EmulatedRig, Emulation
from cbsr_qa.simulate.instruments.streams import WatchedClock
from cbsr_qa_plugins.hardware.esp32_multiplexer import open_multiplexer
from cbsr_qa_plugins.hardware.keithley_2600 import open_source_meter
from cbsr_qa_plugins.hardware.scanned_frames import open_frames

SENSOR = load_sensor_type("disc-100mm").value
MATERIAL = load_material("cbsr-8wt").value
PATTERN = SENSOR.pattern
SCENE_A = 0.4e-3
#: Every reading another one; pairs read across themselves 18 kΩ.
OHM = np.add.outer(100.0 * np.arange(1, 17), np.arange(1, 17)) + np.diag(np.full(16, 18e3))


class TabledWorld:
    """A sheet that is a table of readings per ampere; it counts how often it was solved."""

    def __init__(self, ohm=OHM, *, began_s=0.0, kind=SENSOR):
        self.ohm = np.array(ohm, dtype=float)
        self.drive_ohm = np.abs(np.diag(self.ohm)).copy()
        self.setting = SceneSetting(kind, MATERIAL, Indenter(13.0), 1, SCENE_A, began_s=began_s)
        self.presses = []
        self.asked = []

    def frame(self, time_s, index):
        self.asked.append((time_s, index))
        shape = self.ohm.shape
        current_A = np.full(shape, SCENE_A)
        drive_ohm = np.broadcast_to(self.drive_ohm[:, None], shape)
        return SimulatedFrame(self.ohm * SCENE_A, np.zeros(shape, np.uint8), None, current_A, drive_ohm)


class Scanning:
    """The drivers over emulated instruments; a context manager.

    Answers are waited for long, as a busy computer needs it; tests of answers that stay out say a time of their own.
    """

    def __init__(self, world=None, *, timeout_s=2.0, meter=(), multiplexer=(), frames=()):
        self.world = world or TabledWorld()
        self.clock = WatchedClock()
        self.rig = EmulatedRig(self.clock, self.world, Motion(40 / 60, 10.0, 25.0))
        self.options = {
            "meter": {"address": EMULATED, "timeout_s": timeout_s, **dict(meter)},
            "multiplexer": {
                "address": EMULATED, "inner": "current", "timeout_s": timeout_s, "reconnect_s": 0.0, "boot_s": 0.5,
                **dict(multiplexer),
            },
            "frames": dict(frames),
        }  # fmt: skip
        self.specs = {
            "meter": InstrumentSpec("meter", "keithley-2600", ("source_meter",), self.options["meter"], None),
            "multiplexer": InstrumentSpec(
                "multiplexer", "esp32-multiplexer", ("multiplexer",), self.options["multiplexer"], None
            ),
        }
        self.emulation = Emulation(self.specs.values(), self.rig)
        self.opened = []

    def context(self, role, **options):
        spec = self.specs.get(role)
        told = self.options[role] if spec is None else self.emulation.fill_address(spec).options
        return StationContext(
            role, self.clock, self.world.setting.sensor_type, MATERIAL, Indenter(13.0), 1, {**told, **options}
        )

    def open_meter(self, **options):
        self.opened.append(open_source_meter(self.context("meter", **options)))
        return self.opened[-1]

    def sourcing(self, **options):
        """A meter whose source gives 0.1 mA."""
        meter = self.open_meter(**options)
        meter.source(1e-4)
        return meter

    def open_multiplexer(self, **options):
        self.opened.append(open_multiplexer(self.context("multiplexer", **options)))
        return self.opened[-1]

    def started(self, **options):
        """A multiplexer at its first combination."""
        scanner = self.open_multiplexer(**options)
        scanner.start()
        return scanner

    def open_frames(self, **options):
        self.meter, self.multiplexer = self.open_meter(), self.open_multiplexer()
        frames = open_frames(self.context("frames", **options))
        frames.link({"source_meter": self.meter, "multiplexer": self.multiplexer, "frame_source": frames})
        return frames

    def arm(self, role, fault):
        self.emulation.arm(role, fault)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for one in self.opened:
            one.close()
        self.emulation.close()
        for port in self.emulation.ports.values():
            assert port.failure is None, port.failure


def context(clock=None, **options):
    """A context without an emulation, for tables that are refused."""
    return StationContext("meter", clock or WatchedClock(), SENSOR, MATERIAL, Indenter(13.0), 1, options)
