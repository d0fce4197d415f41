"""An emulated applicator over a pseudo terminal, with a force it can feel, for tests of drivers."""

from dataclasses import replace

import numpy as np
from simulated_setting import MOTION, context

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.plan import InstrumentSpec, SafetyLimits
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.simulate.instruments.rig import EmulatedRig, Emulation
from cbsr_qa.simulate.instruments.streams import WatchedClock

SAFETY = SafetyLimits(force_N=20.0, strain=0.35, travel_radius_mm=41.0, duration_s=43200.0, stale_s=2.0)
RATE_HZ = 8


class WorldForce:
    """What a perfect load cell says of the emulated world; may be told to fail."""

    channel, unit = "force", "N"

    def __init__(self, rig):
        self.rig = rig
        self.silent_from_s = np.inf
        self.more_N = 0.0
        self.error = None

    def identity(self):
        raise NotImplementedError

    def safe_state(self):
        """Nothing to do."""

    def close(self):
        """Nothing to do."""

    def samples_since(self, time_s):
        if self.error:
            raise InstrumentError("load_cell", "test", self.error)
        first, last = int(np.floor(time_s * RATE_HZ)) + 1, int(np.floor(self.rig.clock.now() * RATE_HZ))
        numbers = [n for n in range(max(first, 0), last + 1) if n / RATE_HZ < self.silent_from_s]
        values = [self.rig.world.force_N(n / RATE_HZ, n) + self.more_N for n in numbers]
        return SampleBlock("force", "N", np.array(numbers, dtype=float) / RATE_HZ, np.array(values, dtype=float))


class EmulatedStation:
    """Emulators of some instruments, and what their drivers are opened with."""

    def __init__(self, one_world, **instruments):
        one_world.presses.clear()
        self.rig = EmulatedRig(WatchedClock(), one_world, MOTION)
        self.specs = {
            role: InstrumentSpec(role, options.pop("driver"), (role,), {"address": "emulated"} | options, None)
            for role, options in instruments.items()
        }
        self.emulation = Emulation(self.specs.values(), self.rig)
        self.opened = []

    @property
    def clock(self):
        return self.rig.clock

    @property
    def head(self):
        return self.rig.head

    def open(self, role, factory, *, safety=SAFETY, ask=None, **more):
        addressed = self.emulation.fill_address(self.specs[role])
        told = context(None, clock=self.rig.clock)
        one = factory(replace(told, role=role, options={**addressed.options, **more}, safety=safety, ask=ask))
        self.opened.append(one)
        return one

    def arm(self, role, fault):
        self.emulation.arm(role, fault)

    def close(self):
        for one in self.opened:
            one.close()
        self.emulation.close()
