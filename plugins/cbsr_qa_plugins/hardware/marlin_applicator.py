"""Cartesian force applicator: a Prusa MK3 or another printer with Marlin, with the head instead of the nozzle.

Its quick stop (``M410``) and its halt (``M112``) are software: neither is a safety-rated stop. ``M112`` is never sent
from here, because a halted printer leaves the head in the sheet.
"""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import (
    CLEARANCE_MM,
    SEARCH_CONTACT_STEPS,
    SEARCH_DWELL_S,
    SEARCH_FROM_MM,
    SEARCH_STEP_MM,
    Array,
    Instrument,
    InstrumentError,
    InstrumentIdentity,
    PluginOptions,
    Problem,
    SampleBlock,
    SerialLink,
    StationContext,
    driver,
)
from cbsr_qa_plugins.hardware._driver import HeadDriver, Port, close_on_error, config_error
from cbsr_qa_plugins.hardware._force_watch import ForceWatch, force_among
from cbsr_qa_plugins.hardware._line_sampler import SampleLog
from cbsr_qa_plugins.hardware._marlin_axes import MachineFrame, MarlinAxes, Position
from cbsr_qa_plugins.hardware._marlin_link import MarlinLink

_DRIVER: Final = "marlin-applicator"
_MILLIMETRES: Final = (1.0, 1.0, 1.0)
Steps = Annotated[float, Field(gt=0)]


class MarlinOptions(PluginOptions):
    address: Port
    baud: Annotated[int, Field(ge=1200, le=4_000_000)] = 115200
    timeout_s: Annotated[float, Field(ge=0.05, le=60)] = 1.0
    boot_s: Annotated[float, Field(ge=0.5, le=120)] = 10.0
    firmware: Literal["prusa", "marlin"] = "prusa"
    steps_per_mm: Annotated[tuple[Steps, Steps, Steps], Array] | None = None
    centre_mm: Annotated[tuple[float, float], Array]
    hover_height_mm: float
    z_axis: Literal["up", "down"] = "up"
    acceleration_mm_s2: Annotated[float, Field(ge=1, le=20_000)] = 200.0
    contact_force_N: Annotated[float, Field(ge=0.01, le=5)] = 0.2
    search_depth_mm: Annotated[float, Field(ge=0.1)] = 1.0

    def problems(self) -> Iterator[Problem]:
        """Stock Marlin counts in steps."""
        if self.firmware == "marlin" and self.steps_per_mm is None:
            yield Problem(("steps_per_mm",), "is missing", "stock Marlin counts in steps: give those of x, y and z")

    def machine(self, hover_mm: float) -> MachineFrame:
        return MachineFrame(
            centre_mm=self.centre_mm,
            hover_z_mm=self.hover_height_mm,
            hover_mm=hover_mm,
            upward=1 if self.z_axis == "up" else -1,
            per_mm=(self.steps_per_mm or _MILLIMETRES) if self.firmware == "marlin" else _MILLIMETRES,
            acceleration_mm_s2=self.acceleration_mm_s2,
        )


@driver(_DRIVER, MarlinOptions)
def open_applicator(context: StationContext, options: MarlinOptions) -> "MarlinApplicator":
    """Open a printer as force applicator; it also samples ``head depth`` [mm below the nominal surface].

    Options of its table
    --------------------
    address : serial port, or ``usb:VID:PID:SERIAL``.
    centre_mm : [x, y] of the sheet's centre, in the machine's coordinates.
    hover_height_mm : the machine's z with the head at the station's hover height above the nominal surface.
    firmware : ``"prusa"`` (``Count`` in mm) or ``"marlin"`` (``Count`` in steps: state ``steps_per_mm``).
    z_axis : ``"up"`` if z grows upwards, or ``"down"``.
    steps_per_mm : steps of x, y and z, for stock Marlin.
    baud : baud rate.
    timeout_s : longest time for an acknowledgement.
    boot_s : longest time from opening to the first answer.
    acceleration_mm_s2 : acceleration of all axes; the default is the rig's.
    contact_force_N : force at which the surface search counts the sheet as touched.
    search_depth_mm : greatest depth below the nominal surface that the search goes to.

    Raises
    ------
    ConfigError
        If an option is unknown, missing or out of range.
    InstrumentError
        If there is no answer at the address, or another instrument or firmware answers.
    """
    if context.motion is None:
        raise config_error(context, _DRIVER, " was given no motion", "open it by a station")
    thickness_mm = context.sensor_type.thickness_mm
    if options.search_depth_mm > thickness_mm:
        remedy = f"it must be at most the sheet's thickness, {thickness_mm:g}"
        raise config_error(context, _DRIVER, f": search_depth_mm is {options.search_depth_mm}", remedy)
    link = SerialLink(context.role, options.address, baud=options.baud, timeout_s=options.timeout_s)
    with close_on_error(link):
        return MarlinApplicator(context, options, link, MarlinLink(link, boot_s=options.boot_s))


class MarlinApplicator(HeadDriver):
    """A head on a printer: homes, feels for the surface, presses by depth and watches the force meanwhile.

    InstrumentError if it is not the printer that the station file says; nothing has moved then.
    """

    channel = "head depth"
    unit = "mm"

    def __init__(self, context: StationContext, options: MarlinOptions, link: SerialLink, marlin: MarlinLink) -> None:
        assert context.motion is not None
        super().__init__(context, _DRIVER, options.address)
        self._options, self._motion = options, context.motion
        machine = options.machine(context.motion.hover_mm)
        self._link, self._marlin, self._machine = link, marlin, machine
        self._axes = MarlinAxes(
            marlin, machine, context.clock, lift_mm_s=self._motion.travel_speed_mm_s, fail=self._error
        )
        self._speed_mm_s = self._motion.press_speed_mm_s
        self._surfaces_mm: dict[tuple[float, float], float] = {}
        self._up_mm = -self._motion.hover_mm
        self._depths = SampleLog()
        self._watch: ForceWatch | None = None
        self.identity()
        marlin.command("M410")  # stop in any state; its position is unknown, so it does not move

    # --- instrument ---

    def identity(self) -> InstrumentIdentity:
        lines = self._marlin.query("M115")
        # Abilities of the firmware ("Cap:…", "area:…") follow on lines of their own: they change with an update.
        stated = [line for line in lines if re.match(r"[A-Z_]+:", line)]
        names = dict(found for line in stated for found in re.findall(r"([A-Z_]+):(.*?)(?=\s+[A-Z_]+:|$)", line))
        name = names.get("FIRMWARE_NAME", "")
        firmware = "prusa" if "prusa" in name.lower() else "marlin" if "marlin" in name.lower() else ""
        if firmware != self._options.firmware:
            raise self._error(
                f"firmware {name or ' '.join(lines)[:60]!r} was found; {self._options.firmware!r} was expected",
                "check its address, and 'firmware' in its table: it gives the unit of reported positions",
            )
        return self._build_identity(names.get("MACHINE_TYPE", ""), names.get("UUID", ""), name)

    def alive(self) -> None:
        """Return if it answers and has not restarted since it homed."""
        self._marlin.query("M114")
        if self._axes.ever_homed:
            self._axes.check_homed()

    def safe_state(self) -> None:
        """Stop and begin to lift, and return; see :meth:`MarlinAxes.stop_and_lift`."""
        self._axes.stop_and_lift()

    def close(self) -> None:
        """Close the port; a motion continues to its target."""
        self._link.close()

    def link(self, peers: Mapping[str, Instrument]) -> None:
        """Take the force from the bench's load cell."""
        force = force_among(peers)
        self._watch = ForceWatch(force, self._clock, self._context.safety, fail=self._error)

    # --- sampler: where the head is ---

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the depths queried during motion, and the present one."""
        if self._axes.ever_homed:
            self._axes.check_homed()
            if self._depths.last_s < self._clock.now():
                self._note(self._axes.live())
        return SampleBlock(self.channel, self.unit, *self._depths.read_since(time_s))

    # --- force applicator ---

    def home(self) -> None:
        """Lift, find the zero of all axes, and go to the sheet's centre at the hover height."""
        self._axes.begin()
        self.lower_hover(0.0)
        self._axes.home()
        x, y, _ = self._axes.final_position()
        self._go((x, y, self._machine.hover_z_mm), self._motion.travel_speed_mm_s)
        self._travel(0.0, 0.0)

    def find_surface(self, x_mm: float, y_mm: float) -> float:
        """Step down at a place until the contact force; return the surface's depth from the hover height [mm]."""
        self.move_to(x_mm, y_mm)
        depths, forces = self._search()
        self._lift()
        stiffness, offset = np.polyfit(depths, forces, 1)
        if stiffness <= 0:
            raise self._error("the force does not rise with depth at the surface", "look whether a sheet is in place")
        self._surfaces_mm[(x_mm, y_mm)] = float(-offset / stiffness)
        return self._motion.hover_mm + self._surfaces_mm[(x_mm, y_mm)]

    def expect_surface(self, x_mm: float, y_mm: float, depth_mm: float) -> None:
        """Take the surface at a place as this far below the hover height."""
        self._surfaces_mm[(x_mm, y_mm)] = depth_mm - self._motion.hover_mm

    def lower_hover(self, by_mm: float) -> None:
        """Lift and travel this far below the hover height from now on; its stop lifts to the hover height itself."""
        self._up_mm = by_mm - self._motion.hover_mm

    def move_to(self, x_mm: float, y_mm: float) -> None:
        """Travel at the hover height, lifting first if need be."""
        self._axes.begin()
        self._check_place(x_mm, y_mm)
        self._lift()
        self._travel(x_mm, y_mm)

    def press(self, depth_mm: float, speed_mm_s: float) -> None:
        """Go this far below the surface found here, or else found nearest, or else nominal."""
        self._axes.begin()
        self._check_press(depth_mm, speed_mm_s)
        self._axes.check_homed()
        surface = self._surface_mm()
        self._speed_mm_s = speed_mm_s
        self._require_watch().look()
        if self._depth_mm() < surface - CLEARANCE_MM:
            self._go_to_depth(surface - CLEARANCE_MM, self._motion.travel_speed_mm_s, watched=True)
        self._go_to_depth(surface + depth_mm, speed_mm_s, watched=True)

    def release(self) -> None:
        """Go up to the hover height: out of the sheet at the speed of the last press, then faster."""
        self._axes.begin()
        self._lift()

    # --- how ---

    def _search(self) -> tuple[list[float], list[float]]:
        """Step down past the contact force; return the last depths [mm] and their forces [N]."""
        watch, press_mm_s = self._require_watch(), self._motion.press_speed_mm_s
        self._speed_mm_s = press_mm_s
        watch.look()
        self._go_to_depth(-SEARCH_FROM_MM, self._motion.travel_speed_mm_s, watched=True)
        depths: list[float] = []
        forces: list[float] = []
        while sum(force >= self._options.contact_force_N for force in forces) < SEARCH_CONTACT_STEPS:
            depth_mm = self._depth_mm()
            if depth_mm > self._options.search_depth_mm:
                raise self._give_up(
                    f"no contact force of {self._options.contact_force_N:g} N"
                    f" down to {self._options.search_depth_mm:g} mm below nominal",
                    "look whether a sheet is in place, and whether the load cell reads pushes as positive",
                )
            self._go_to_depth(depth_mm + SEARCH_STEP_MM, press_mm_s, watched=True)
            stepped_s = self._clock.now()
            self._clock.sleep(SEARCH_DWELL_S)
            with self._axes.lifting_on_error():
                forces.append(watch.mean_since(stepped_s))
            depths.append(self._depth_mm())
            if len(forces) == 1 and abs(forces[0]) >= self._options.contact_force_N:
                raise self._give_up(
                    f"the load cell reads {forces[0]:.3g} N {SEARCH_FROM_MM:g} mm above the nominal surface",
                    "tare it with the head in the air, and check 'hover_height_mm' in the applicator's table",
                )
        return depths[-SEARCH_CONTACT_STEPS:], forces[-SEARCH_CONTACT_STEPS:]

    def _give_up(self, reason: str, remedy: str) -> InstrumentError:
        """Lift the head, and return why the surface was not found."""
        with suppress(InstrumentError):
            self._lift()
        return self._error(reason, remedy)

    def _lift(self) -> None:
        self._axes.check_homed()
        clear_mm = self._surface_mm() - CLEARANCE_MM
        if self._depth_mm() > clear_mm:
            self._go_to_depth(clear_mm, self._speed_mm_s)
        self._go_to_depth(self._up_mm, self._motion.travel_speed_mm_s)

    def _travel(self, x_mm: float, y_mm: float) -> None:
        self._go(self._machine.position(x_mm, y_mm, self._up_mm), self._motion.travel_speed_mm_s)

    def _go_to_depth(self, depth_mm: float, speed_mm_s: float, *, watched: bool = False) -> None:
        x, y, _ = self._axes.final_position()
        self._go((x, y, self._machine.position(0.0, 0.0, depth_mm)[2]), speed_mm_s, watched=watched)

    def _go(self, goal: Position, speed_mm_s: float, *, watched: bool = False) -> None:
        watch = self._require_watch() if watched else None

        def look(live: Position) -> None:
            self._note(live)
            if watch is not None:
                watch.look()

        self._axes.go(goal, speed_mm_s, look)

    def _note(self, live: Position) -> None:
        if (now_s := self._clock.now()) > self._depths.last_s:
            self._depths.append(now_s, self._machine.depth_mm(live[2]))

    def _depth_mm(self) -> float:
        """Depth below the nominal surface at its position."""
        return self._machine.depth_mm(self._axes.final_position()[2])

    def _surface_mm(self) -> float:
        """Where the surface is taken to be below nominal: found here, or else found nearest, or else nominal."""
        x, y, _ = self._axes.final_position()
        here = (x - self._machine.centre_mm[0], y - self._machine.centre_mm[1])
        return min(
            ((math.dist(place, here), depth) for place, depth in self._surfaces_mm.items()), default=(0.0, 0.0)
        )[1]

    def _require_watch(self) -> ForceWatch:
        if self._watch is None:
            raise self._error("no instrument measures the force", "link it with a load cell before it presses")
        return self._watch
