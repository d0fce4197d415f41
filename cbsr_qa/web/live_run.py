"""A run as it is watched: what it has stored so far, its latest image, its traces, and how each place was seen."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import monotonic
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.live import LivePreview, PlacePreview
from cbsr_qa.config.merging import Configuration, restore
from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.plan.steps import Press, Role
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.report.draw.sheet import Raster
from cbsr_qa.station.plan import ScheduledPhase, schedule
from cbsr_qa.station.setup import plan_of
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.runs.live import LivePhase, RunTail
from cbsr_qa.web.drawings import SheetDrawing, png

#: Length of the traces [s of the run].
TRACE_S: Final = 240.0
#: Pixels of a live image along its longer side.
_PIXELS: Final = 160
#: Time later than any of a run [s].
_NEVER_S: Final = 1e12
#: Length of the end of a hold by which a place is judged [s].
_STEADY_S: Final = 8.0


@dataclass(frozen=True, slots=True)
class Place:
    """One planned press of the grid.

    Parameters
    ----------
    seen : quality of its image; None before it was pressed.
    now : whether the head is there.
    """

    load: Load
    seen: PlacePreview | None
    now: bool


@dataclass(frozen=True, slots=True, eq=False)
class DrawnPlaces:
    """A sheet from above with the planned places of its grid, each once."""

    sheet: SheetDrawing
    loads: tuple[Load, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LiveView:
    """Content of a page on a run in progress.

    Parameters
    ----------
    place_number : number of the place under the head or next, counted from 1; 0 outside the grid, and in a grid that
        presses a place more than once.
    frame : number of the imaged frame, in the address of its picture; 0 without one.
    change_percent : change at the dark end of the scale; 0 without an image.
    force_N, conductance_percent : points (time_s, value) of the last :data:`TRACE_S`; the conductance relative to the
        unloaded sheet, as the mean of all readings.
    error_N : points (time_s, value) of the expected force error at each decision between presses; empty without any.
    silent_s : time since the last frame, by this computer's clock; None before the first.
    no_image : reason for a missing image, in words; empty with an image.
    """

    sheet: SheetDrawing
    phases: tuple[LivePhase, ...]
    planned_phases: int
    loads_done: int
    loads_planned: int
    places: tuple[Place, ...]
    place_number: int
    frame: int
    change_percent: float
    force_N: tuple[tuple[float, float], ...]
    conductance_percent: tuple[tuple[float, float], ...]
    error_N: tuple[tuple[float, float], ...]
    silent_s: float | None
    no_image: str


class LiveRun:
    """Follows one run in the store. Used by one thread.

    Parameters
    ----------
    run : identifier of the run.
    """

    def __init__(self, store: Repository, plugins: Plugins, run: str) -> None:
        self.run = run
        self._store, self._plugins = store, plugins
        self.configuration: Configuration = restore(store.runs.read_configuration(run))
        self._schedule: tuple[ScheduledPhase, ...] = schedule(plan_of(self.configuration, plugins))
        self._planned = _plan_places(self._schedule)
        places_mm = {(step.load.x_mm, step.load.y_mm) for _, _, step in self._planned}
        self._sheet = SheetDrawing.from_sensor_type(
            self.configuration.sensor_type, self.configuration.station.indenter, places_mm
        )
        self._tail: RunTail | None = None
        self._preview: LivePreview | None = None
        self._raster: Raster | None = None
        self._no_image = ""
        self._force: deque[tuple[float, float]] = deque()
        self._conductance: deque[tuple[float, float]] = deque()
        self._level: float | None = None
        self._seen: dict[tuple[int, int], PlacePreview] = {}
        self._frame: FrameBlock | None = None
        self._frames = 0
        self._frame_at: float | None = None
        self._change = 0.0
        self.picture = b""

    def update(self) -> None:
        """Read what is new, and image the latest frame. StoreError if the database cannot be read."""
        last_tail = self._tail
        counts_seen = (
            {}
            if last_tail is None
            else {"frames_after": last_tail.frames_seen, "samples_after": last_tail.samples_seen}
        )
        self._tail = tail = self._store.live.read_tail(self.run, **counts_seen)
        self._take_frames(tail)
        for _, block in tail.samples:
            if block.channel == "force":
                self._force.extend(zip(block.time_s.tolist(), block.values.tolist(), strict=True))
        _forget(self._force)
        if self._preview is None:
            self._prepare(tail)
        if self._preview is not None:
            self._image()
            self._judge_places(self._preview, tail)

    def view(self, pressed: str) -> LiveView:
        """Return the content of the page.

        Parameters
        ----------
        pressed : label of the load under the head now; empty for none.
        """
        tail = self._tail
        phases = () if tail is None else tail.phases
        current = phases[-1].index if phases else 0
        places = self._places(current, pressed)
        return LiveView(
            sheet=self._sheet,
            phases=phases,
            planned_phases=len(self._schedule),
            loads_done=0 if tail is None else len(tail.loads),
            loads_planned=sum(phase.loads if phase.goal is None else phase.goal.at_most for phase in self._schedule),
            places=tuple(places),
            place_number=_number_place(places) if phases and phases[-1].role is Role.GRID else 0,
            frame=self._frames if self.picture else 0,
            change_percent=100 * self._change,
            force_N=thin_trace(self._force),
            conductance_percent=thin_trace(self._conductance),
            error_N=tuple(
                (made.time_s, made.expected_N)
                for made in (() if tail is None else tail.decisions)
                if made.expected_N is not None
            ),
            silent_s=None if self._frame_at is None else monotonic() - self._frame_at,
            no_image=self._no_image,
        )

    def draw_places(self) -> DrawnPlaces:
        """Return the sheet with its planned places; reads nothing."""
        load_by_label = {press.load.label: press.load for _, _, press in self._planned}
        return DrawnPlaces(self._sheet, tuple(load_by_label.values()))

    def _places(self, current: int, pressed: str) -> list[Place]:
        return [
            Place(
                press.load,
                self._seen.get((phase, load)),
                current == phase and (phase, load) not in self._seen and press.load.label == pressed,
            )
            for phase, load, press in self._planned
        ]

    def _take_frames(self, tail: RunTail) -> None:
        pattern = self.configuration.sensor_type.pattern.usable()
        for _, block in tail.frames:
            self._frames += len(block)
            self._frame, self._frame_at = block.select(slice(-1, None)), monotonic()
            is_sound = pattern & ~((block.flags & UNUSABLE) != 0).any(axis=0)
            levels = np.abs(block.voltages[:, is_sound]).mean(axis=1)
            if not np.isfinite(levels).all() or not (levels > 0).all():
                continue
            if self._level is None:
                self._level = float(levels[0])
            for time_s, level in zip(block.time_s, levels, strict=True):
                self._conductance.append((float(time_s), 100 * (self._level / float(level) - 1)))
        _forget(self._conductance)

    def _prepare(self, tail: RunTail) -> None:
        """Prepare imaging once the first press after unloaded frames has begun, or there are enough of them."""
        phase = next((phase for phase in tail.phases if phase.unloaded_from_s is not None), None)
        if phase is None or phase.unloaded_from_s is None or self._no_image:
            return
        first_press_s = min(
            (load.press_start_s for index, load in tail.loads if index == phase.index), default=_NEVER_S
        )
        settings = self.configuration.recipe.analysis
        unloaded_frames = self._store.live.read_frames(self.run, phase.index, phase.unloaded_from_s, first_press_s)
        if unloaded_frames is None or len(unloaded_frames) <= settings.noise_floor_frames:
            return
        unloaded_frames = unloaded_frames.select(slice(0, settings.noise_floor_frames + settings.reference_frames))
        sensor_type, station = self.configuration.sensor_type, self.configuration.station
        try:
            choice = self.configuration.recipe.reconstruction
            reconstruction = create_plugin(self._plugins, Kind.RECONSTRUCTION, choice, "[reconstruction]")
            self._preview = LivePreview.prepare(
                sensor_type, station.indenter, settings, reconstruction, unloaded_frames
            )
        except CbsrError as error:
            self._no_image = error.reason
            return
        self._level = float(np.abs(unloaded_frames.voltages[:, sensor_type.pattern.usable()]).mean())
        self._raster = Raster(self._preview.mesh, sensor_type.outline, _PIXELS)

    def _image(self) -> None:
        if self._frame is None or self._preview is None or self._raster is None:
            return
        try:
            values = self._preview.image(self._frame)
        except CbsrError as error:
            self._no_image = error.reason
            return
        self._no_image = ""
        largest_change = float(np.abs(values).max())
        # The scale grows at once and shrinks slowly: an unloaded sheet is not shown as a picture of its noise.
        self._change = max(largest_change, 0.9 * self._change, 4 * self._preview.noise_floor)
        self.picture = png(self._raster.picture(values), self._change)
        self._frame = None

    def _judge_places(self, preview: LivePreview, tail: RunTail) -> None:
        for phase, record in tail.loads:
            key = (phase, record.index)
            role = self._schedule[phase].role if phase < len(self._schedule) else Role.OTHER
            if key not in self._seen and role is Role.GRID:
                start_s = max(record.hold_start_s, record.release_start_s - _STEADY_S)
                steady_frames = self._store.live.read_frames(self.run, phase, start_s, record.release_start_s)
                if steady_frames is not None:
                    self._seen[key] = preview.place(record.load, steady_frames)


def _plan_places(phases: Sequence[ScheduledPhase]) -> list[tuple[int, int, Press]]:
    """Return the presses of the first grid with their phase and load; none without a grid."""
    grid = next((phase for phase in phases if phase.role is Role.GRID), None)
    if grid is None:
        return []
    return [
        (grid.index, step.load, step.step)
        for step in grid.steps
        if isinstance(step.step, Press) and step.load is not None
    ]


def _number_place(places: Sequence[Place]) -> int:
    """Return the number of the place under the head, else of the next one; 0 if places are pressed more than once."""
    if len({place.load.label for place in places}) < len(places):
        return 0
    open_places = (number for number, place in enumerate(places, start=1) if place.now or place.seen is None)
    return next(open_places, len(places))


def _forget(trace: deque[tuple[float, float]]) -> None:
    while trace and trace[0][0] < trace[-1][0] - TRACE_S:
        trace.popleft()


def thin_trace(trace: Sequence[tuple[float, float]], most: int = 240) -> tuple[tuple[float, float], ...]:
    """Return a trace of at most ``most`` points: the lowest and the highest of each stretch, in order."""
    points = list(trace)
    if len(points) <= most:
        return tuple(points)
    extremes: list[tuple[float, float]] = []
    edges = np.linspace(0, len(points), most // 2 + 1).astype(int)
    for start, end in pairwise(edges):
        stretch = points[start:end]
        extremes += sorted({min(stretch, key=lambda point: point[1]), max(stretch, key=lambda point: point[1])})
    return tuple(extremes)
