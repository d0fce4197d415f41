"""Scene files: what the simulated world contains, and what is recorded of it."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from cbsr_qa.config.choices import Choice, read_choice, tables
from cbsr_qa.config.station import IndenterTable
from cbsr_qa.config.tables import PRINTABLE, FileModel, OpenTable, PrintableLine, as_domain
from cbsr_qa.config.text import plainly
from cbsr_qa.domain.plan.plan import Motion, PluginChoice, Scene
from cbsr_qa.domain.plan.scene_plan import MOST_FRAMES, SceneLoad, ScenePlan
from cbsr_qa.domain.plan.steps import CLEARANCE_MM
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.problems import Problem, Table

Positive = Annotated[float, Field(gt=0)]
Name = Annotated[str, Field(min_length=1, max_length=64)]
#: Current from a picoampere to ten amperes [mA]: readings and their squares stay numbers.
Current = Annotated[float, Field(ge=1e-9, le=1e4)]
#: Period of frames from a microsecond to ten minutes [s]. Force is sampled 8 times a second, so that a frame and a
#: recording have a number of samples that a computer holds.
Period = Annotated[float, Field(ge=1e-6, le=600)]
Duration = Annotated[float, Field(gt=0, le=1e6)]
#: Resistance from a short to an open circuit [ohm]: currents and voltages stay numbers.
Resistance = Annotated[float, Field(ge=1e-6, le=1e12)]
#: Length beyond any sheet [mm]. Like the ranges of speed and time below, it keeps sums of times numbers.
Length = Annotated[float, Field(ge=-1e6, le=1e6)]
#: Diameter of a head that covers some of the sheet's elements and has a measurable force [mm].
Diameter = Annotated[float, Field(ge=1, le=1000)]
Speed = Annotated[float, Field(ge=0.01, le=1e6)]
Moment = Annotated[float, Field(ge=0, le=1e9)]
NameOrPath = Annotated[str, Field(min_length=1, max_length=255)]

#: Largest seed: what every tool that reads a recording can hold as an integer.
MOST_SEED = 2**31 - 1
#: Tables used by a station's run; all others are for ``cbsr-qa scene``.
STATION_TABLES = ("scene", "effects")


class SceneTable(Table):
    """``[scene]``."""

    name: Annotated[Name, PRINTABLE]
    current_mA: Current
    frame_period_s: Period
    sheet_mesh_size_mm: Positive
    not_modelled: list[PrintableLine] = Field(default_factory=list)
    reference_ring_ohm: Annotated[list[Resistance] | None, Field(min_length=3)] = None


class SensorTable(Table):
    """``[sensor]``: the simulated sensor, unless a station states it."""

    sensor_type: NameOrPath
    material: NameOrPath


class HeadTable(IndenterTable):
    """``[head]``: outline and motion of every head that presses; the rig's by default."""

    diameter_mm: Diameter | None = None
    press_speed_mm_per_min: Speed = 40.0
    travel_speed_mm_per_min: Speed = 600.0
    hover_mm: Annotated[float, Field(ge=CLEARANCE_MM, le=1e4)] = 25.0

    def motion(self) -> Motion:
        return Motion(
            press_speed_mm_s=self.press_speed_mm_per_min / 60,
            travel_speed_mm_s=self.travel_speed_mm_per_min / 60,
            hover_mm=self.hover_mm,
        )


class RecordingTable(Table):
    """``[recording]``: what ``cbsr-qa scene run`` records."""

    seed: Annotated[int, Field(ge=0, le=MOST_SEED)]
    duration_s: Duration


class LoadTable(Table):
    """``[[loads]]``: one press."""

    x_mm: Length
    y_mm: Length
    strain_percent: Annotated[float, Field(gt=0, lt=100)]
    start_s: Moment
    hold_s: Annotated[float, Field(gt=0, le=1e9)]
    head: Annotated[int, Field(ge=1, le=64)] = 1


class EffectTable(OpenTable):
    """``[[effects]]``: an effect that is on, and its parameters beside its name."""

    name: Name


class SceneFile(FileModel[ScenePlan]):
    """A scene file. What needs the sensor's size is checked in :mod:`cbsr_qa.config.scene_checks`."""

    scene: SceneTable
    sensor: SensorTable | None = None
    head: HeadTable = Field(default_factory=HeadTable)
    recording: RecordingTable | None = None
    loads: list[LoadTable] = Field(default_factory=list)
    effects: list[EffectTable] = Field(default_factory=list)

    @classmethod
    def choices(cls, data: Any) -> Iterator[Choice]:
        for index, effect in tables(data, "effects"):
            yield from read_choice(Kind.EFFECT, effect, ("effects", index), "name")

    def problems(self) -> Iterator[Problem]:
        """An effect is on at most once; a recording has frames, and not too many."""
        seen_names: set[str] = set()
        for index, effect in enumerate(self.effects):
            if effect.name in seen_names:
                yield Problem(("effects", index, "name"), f"is {effect.name!r}, which is already on")
            seen_names.add(effect.name)
        yield from self.head.problems("head")
        yield from self._length_problems()

    def _length_problems(self) -> Iterator[Problem]:
        if self.recording is None:
            return
        period_s, duration_s = self.scene.frame_period_s, self.recording.duration_s
        duration_text = plainly(duration_s)
        if duration_s < period_s * (1 - 1e-9):
            yield Problem(("recording", "duration_s"), f"is {duration_text}; one frame takes {plainly(period_s)} s")
        if duration_s / period_s > MOST_FRAMES * (1 + 1e-9):
            finding = f"is {duration_text}, {duration_s / period_s:.10g} frames of {plainly(period_s)} s"
            longest = f"at most {MOST_FRAMES} frames are recorded, {MOST_FRAMES * period_s:g} s"
            yield Problem(("recording", "duration_s"), f"{finding}; {longest}")

    def to_domain(self) -> ScenePlan:
        return ScenePlan(
            scene=self._scene(),
            sensor_type=None if self.sensor is None else self.sensor.sensor_type,
            material=None if self.sensor is None else self.sensor.material,
            indenter=self.head.to_domain(),
            motion=self.head.motion(),
            seed=None if self.recording is None else self.recording.seed,
            duration_s=None if self.recording is None else self.recording.duration_s,
            loads=tuple(as_domain(SceneLoad, load) for load in self.loads),
        )

    def _scene(self) -> Scene:
        return as_domain(
            Scene,
            self.scene,
            effects=tuple(PluginChoice(e.name, e.options) for e in self.effects),
            current_A=self.scene.current_mA / 1000,
            reference_ring_ohm=tuple(self.scene.reference_ring_ohm or ()),
        )
