"""A whole bench in one object: frames, head and load cell over one simulated world."""

import math
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from typing import Any, Final

import numpy as np

from cbsr_qa.domain import ConfigError, InstrumentError
from cbsr_qa.domain.plan import CONTACT_LENGTH_MM, Motion
from cbsr_qa.domain.readings import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.run import InstrumentIdentity
from cbsr_qa.plugin import StationContext
from cbsr_qa.simulate import SimulatedHead, SimulatedWorld, StepAddresses
from cbsr_qa.system import in_ticks, on_tick

_DRIVER: Final = "simulated-bench"
_FORCE_RATE_HZ: Final = 8  # of the rig's load cell; a power of two, so that sample times are exact

#: Options of the instrument's table and their lowest values. The station's motion is the default of the first two.
_OPTIONS: Final[Mapping[str, float]] = {
    "hover_mm": 1.0,
    "travel_speed_mm_s": 0.01,
    "contact_length_mm": 1e-6,
}
#: Where the station states none: the rig's press speed of 40 mm/min, and the shipped station's other numbers.
_RIG_MOTION: Final = Motion(press_speed_mm_s=40 / 60, travel_speed_mm_s=10.0, hover_mm=25.0)
_OTHER_KEYS: Final = ("scene",)  # read by whoever opened the bench


def open_bench(context: StationContext) -> "SimulatedBench":
    """Open a simulated bench (frame source, force applicator and the sampler ``force``).

    Options of its table: ``hover_mm`` and ``travel_speed_mm_s`` (default: the station's motion),
    ``contact_length_mm`` (contact impedance over sheet resistance, default 0.2).

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or the scene or its effects are missing or do not fit together.
    """
    return SimulatedBench(context)


class SimulatedBench:
    """Simulated instruments that share one world and the station's clock."""

    channel = "force"
    unit = "N"

    def __init__(self, context: StationContext) -> None:
        if context.scene is None or context.effect_factory is None:
            raise ConfigError(
                f"instrument {context.role!r} ({_DRIVER}) was given no scene",
                remedy='name one in its table, e.g. scene = "base"',
            )
        options = _checked(context)
        self._context = context
        self._scene = context.scene
        self.world = SimulatedWorld(
            context.scene,
            context.sensor_type,
            context.material,
            context.indenter,
            seed=context.seed,
            effect_factory=context.effect_factory,
            contact_length_mm=options.get("contact_length_mm", CONTACT_LENGTH_MM),
            began_s=context.resumed_at_s,
        )
        self._addresses = StepAddresses(context.clock, _FORCE_RATE_HZ)
        self._head = SimulatedHead(context.clock, self.world, _motion(context, options), role=context.role)
        self._open = True

    def begin_step(self, phase: int, number: int) -> None:
        """Address random numbers by this step from here on."""
        self._head.count_from(self._addresses.begin_step(phase, number))

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Name the scene and the seed: together with the software's version they are this bench."""
        self._check_open()
        model = f"simulated bench, scene {self._scene.name}, seed {self._context.seed}"
        return InstrumentIdentity(self._context.role, _DRIVER, model, str(self._context.seed), "", simulated=True)

    def safe_state(self) -> None:
        """Start lifting the head and return at once."""
        self._head.drop_everything()

    def close(self) -> None:
        """Take no more orders."""
        self._open = False

    # --- frame source ---

    @property
    def frame_period_s(self) -> float:
        """Time of one frame, in whole ticks of the clock [s]."""
        return on_tick(self._scene.frame_period_s)

    def acquire(self, count: int) -> FrameBlock:
        """Take frames one after the other, all readings in a frame's middle where no effect says otherwise."""
        self._check_open()
        if count < 1:
            raise InstrumentError(
                self._context.role, "simulated", f"{count} frames were asked for; at least 1 is needed"
            )
        clock, period_s = self._context.clock, self.frame_period_s
        half_s = in_ticks(period_s / 2)
        times, frames = [], []
        for _ in range(count):
            middle_s = clock.now() + half_s
            frames.append(self.world.frame(middle_s, self._addresses.frame()))
            times.append(middle_s)
            clock.sleep(period_s)
        voltages, flags = np.stack([one.voltages for one in frames]), np.stack([one.flags for one in frames])
        own = [one.time_s for one in frames if one.time_s is not None]
        at_s = np.stack(own) if own else None
        return FrameBlock(np.array(times), voltages, flags, VoltageUnit.VOLT, self._scene.current_A, at_s)

    # --- sampler: the load cell ---

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the force samples after a time up to now, worked out only now.

        They come 8 a second from the beginning of each step, and from each order to the head within it.
        """
        self._check_open()
        taken = list(self._addresses.samples(time_s, self._context.clock.now()))
        forces = [self.world.force_N(at_s, address) for at_s, address in taken]
        times = np.array([at_s for at_s, _ in taken], dtype=np.float64)
        return SampleBlock(self.channel, self.unit, times, np.array(forces, dtype=np.float64))

    # --- force applicator ---

    def home(self) -> None:
        """Lift the head and take it to the sheet's centre."""
        self._check_open()
        self._begin_act()
        self._head.travel(0.0, 0.0)

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Step down at a place until the contact force; returns the depth from the hover height [mm]."""
        self.move_to(x_mm, y_mm)
        self._begin_act()
        return self._head.find_surface(self._mean_force_N)

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Travel at the hover height."""
        self._check_open()
        outline = self._context.sensor_type.outline
        if not outline.clearance_mm(np.array([[x_mm, y_mm]]))[0] >= 0:
            place = f"({x_mm:g}, {y_mm:g}) mm"
            raise InstrumentError(
                self._context.role, place, "outside the sheet", remedy=f"the sheet {outline.words()}"
            )
        self._begin_act()
        self._head.travel(x_mm, y_mm)

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Go this far below the surface found here."""
        self._check_open()
        thickness_mm = self._context.sensor_type.thickness_mm
        if not (0 <= depth_mm < thickness_mm and speed_mm_s > 0):
            raise InstrumentError(
                self._context.role,
                "simulated",
                f"cannot press {depth_mm:g} mm deep at {speed_mm_s:g} mm/s",
                remedy=f"the depth is from 0 to below the sheet's {thickness_mm:g} mm, the speed above 0",
            )
        self._begin_act()
        self._head.press(depth_mm, speed_mm_s)

    def release(self) -> None:
        """Go up to the hover height."""
        self._check_open()
        self._begin_act()
        self._head.lift()

    def _begin_act(self) -> None:
        self._head.count_from(self._addresses.begin_act())

    def _mean_force_N(self, window_s: float) -> float:
        return float(self.samples_since(self._context.clock.now() - window_s).values.mean())

    def _check_open(self) -> None:
        if not self._open:
            raise InstrumentError(self._context.role, "simulated", "the bench is closed", remedy="open it again")


def _checked(context: StationContext) -> dict[str, float]:
    known = [*_OPTIONS, *_OTHER_KEYS]
    for key, value in context.options.items():
        if key not in known:
            near = get_close_matches(key, known, n=1)
            meant = f"did you mean {near[0]!r}? " if near else ""
            raise ConfigError(
                f"instrument {context.role!r} ({_DRIVER}) has no option {key!r}",
                remedy=f"{meant}it has {', '.join(known)}",
            )
        if key in _OPTIONS and not _within(value, _OPTIONS[key]):
            raise ConfigError(
                f"instrument {context.role!r} ({_DRIVER}): {key} is {value!r}",
                remedy=f"it is a finite number of at least {_OPTIONS[key]:g}",
            )
    return {key: float(context.options[key]) for key in _OPTIONS if key in context.options}


def _within(value: Any, lowest: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and lowest <= value < math.inf


def _motion(context: StationContext, options: Mapping[str, float]) -> Motion:
    motion = context.motion or _RIG_MOTION
    own = {key: options[key] for key in ("hover_mm", "travel_speed_mm_s") if key in options}
    return replace(motion, **own)
