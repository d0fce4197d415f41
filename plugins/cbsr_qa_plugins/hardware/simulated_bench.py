"""A whole bench in one object: frames, head and load cell over one simulated world."""

from dataclasses import replace
from typing import Annotated, Final

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import (
    CONTACT_LENGTH_MM,
    FrameBlock,
    InstrumentIdentity,
    PluginOptions,
    SampleBlock,
    StationContext,
    VoltageUnit,
    driver,
)
from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.simulate.streams import StepAddresses
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.system.clock import on_tick, round_to_ticks
from cbsr_qa_plugins.hardware._driver import RIG_MOTION, HeadDriver, config_error

_DRIVER: Final = "simulated-bench"
_FORCE_RATE_HZ: Final = 8  # of the rig's load cell; a power of two, so that sample times are exact


class BenchOptions(PluginOptions):
    """Options of its table. The station's motion is the default of the first two."""

    hover_mm: Annotated[float, Field(ge=1)] | None = None
    travel_speed_mm_s: Annotated[float, Field(ge=0.01)] | None = None
    contact_length_mm: Annotated[float, Field(ge=1e-6)] = CONTACT_LENGTH_MM
    scene: str | None = None


@driver(_DRIVER, BenchOptions)
def open_bench(context: StationContext, options: BenchOptions) -> "SimulatedBench":
    """Open a simulated bench (frame source, force applicator and the sampler ``force``).

    Options of its table
    --------------------
    hover_mm, travel_speed_mm_s : hover height and travel speed; by default those of the station.
    contact_length_mm : contact impedance over sheet resistance.
    scene : file or name of the scene.

    Raises
    ------
    ConfigError
        If an option is unknown or out of range, or the scene or its effects are missing or do not fit together.
    """
    return SimulatedBench(context, options)


class SimulatedBench(HeadDriver):
    """Simulated instruments that share one world and the station's clock."""

    channel = "force"
    unit = "N"

    def __init__(self, context: StationContext, options: BenchOptions) -> None:
        if context.scene is None or context.effect_factory is None:
            remedy = 'name one in its table, e.g. scene = "base"'
            raise config_error(context, _DRIVER, " was given no scene", remedy)
        super().__init__(context, _DRIVER, "simulated")
        self._scene = context.scene
        self.world = SimulatedWorld(
            context.scene,
            context.sensor_type,
            context.material,
            context.indenter,
            seed=context.seed,
            effect_factory=context.effect_factory,
            contact_length_mm=options.contact_length_mm,
            began_s=context.resumed_at_s,
        )
        self._addresses = StepAddresses(context.clock, _FORCE_RATE_HZ)
        own = options.model_dump(include={"hover_mm", "travel_speed_mm_s"}, exclude_none=True)
        motion = replace(context.motion or RIG_MOTION, **own)
        self._head = SimulatedHead(context.clock, self.world, motion, role=context.role)
        self._open = True

    def begin_step(self, phase: int, number: int) -> None:
        """Address random numbers by this step from here on."""
        self._head.count_from(self._addresses.begin_step(phase, number))

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        """Name the scene and the seed: together with the software's version they are this bench."""
        self._check_open()
        model = f"simulated bench, scene {self._scene.name}, seed {self._context.seed}"
        return self._build_identity(model, str(self._context.seed), simulated=True)

    def safe_state(self) -> None:
        """Start lifting the head and return at once."""
        self._head.drop_everything()

    def close(self) -> None:
        self._open = False

    # --- frame source ---

    @property
    def frame_period_s(self) -> float:
        """Time of one frame, in whole ticks of the clock [s]."""
        return on_tick(self._scene.frame_period_s)

    def acquire(self, count: int) -> FrameBlock:
        """Take frames one after the other, all readings in a frame's middle where no effect says otherwise."""
        self._check_open()
        self._check_count(count)
        clock, period_s = self._clock, self.frame_period_s
        half_s = round_to_ticks(period_s / 2)
        times, frames = [], []
        for _ in range(count):
            middle_s = clock.now() + half_s
            frames.append(self.world.frame(middle_s, self._addresses.frame()))
            times.append(middle_s)
            clock.sleep(period_s)
        voltages, flags = np.stack([frame.voltages for frame in frames]), np.stack([frame.flags for frame in frames])
        own = [frame.time_s for frame in frames if frame.time_s is not None]
        at_s = np.stack(own) if own else None
        return FrameBlock(np.array(times), voltages, flags, VoltageUnit.VOLT, self._scene.current_A, at_s)

    # --- sampler: the load cell ---

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the force samples after a time up to now, computed on demand.

        They come 8 a second from the beginning of each step, and from each order to the head within it.
        """
        self._check_open()
        samples = list(self._addresses.samples(time_s, self._clock.now()))
        forces = [self.world.force_N(at_s, address) for at_s, address in samples]
        times = np.array([at_s for at_s, _ in samples], dtype=np.float64)
        return SampleBlock(self.channel, self.unit, times, np.array(forces, dtype=np.float64))

    # --- force applicator ---

    def home(self) -> None:
        """Lift the head and take it to the sheet's centre."""
        self._begin_act()
        self._head.lower_hover(0.0)
        self._head.travel(0.0, 0.0)

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Step down at a place until the contact force; returns the depth from the hover height [mm]."""
        self.move_to(x_mm, y_mm)
        self._head.approach()
        self._begin_act()  # whatever height it came from
        return self._head.find_surface(
            lambda window_s: float(self.samples_since(self._clock.now() - window_s).values.mean())
        )

    def expect_surface(self, x_mm: float, y_mm: float, depth_mm: float) -> None:
        """Take the surface at a place as this far below the hover height."""
        self._head.expect_surface(x_mm, y_mm, depth_mm)

    def lower_hover(self, by_mm: float) -> None:
        """Travel this far below the hover height from now on."""
        self._head.lower_hover(by_mm)

    def move_to(self, x_mm: float, y_mm: float) -> None:
        self._check_place(x_mm, y_mm)
        self._begin_act()
        self._head.travel(x_mm, y_mm)

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Go this far below the surface found here."""
        self._check_press(depth_mm, speed_mm_s)
        self._begin_act()
        self._head.press(depth_mm, speed_mm_s)

    def release(self) -> None:
        self._begin_act()
        self._head.lift()

    def _begin_act(self) -> None:
        self._check_open()
        self._head.count_from(self._addresses.begin_act())

    def _check_open(self) -> None:
        if not self._open:
            raise self._error("the bench is closed", "open it again")
