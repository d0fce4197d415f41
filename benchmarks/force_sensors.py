"""Simulated sensors whose response varies over the sheet, with the loads that a force is learned from and tested on.

Runs are those of the shipped bench, but for frames that no force is worked out from: of every hold and every rest the
last four are taken.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_material
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, Role, Step
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, join_frames, join_samples
from cbsr_qa.domain.readings.loads import Load, LoadRecord
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import PhaseRecord, RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.plan import Plan, PlannedPhase
from cbsr_qa.station.setup import open_station, plan_of, station_clock
from cbsr_qa.studies.simulated import configuration_of, copy_shipped
from cbsr_qa.system.clock import Clock

Array = NDArray[np.float64]

NINE, PLACES, RANDOM = "nine locations", "calibration places", "random loads"
_FRAMES = 4
_SHEET: tuple[dict[str, Any], ...] = (
    {"name": "uneven-response", "deviation": 0.2, "correlation_mm": 20.0},
    {"name": "residue", "share": 0.03, "decay_s": 300.0},
)
_SHORT: tuple[dict[str, Any], ...] = (_SHEET[0] | {"correlation_mm": 10.0}, _SHEET[1])
_SHIFTED: tuple[dict[str, Any], ...] = (
    *_SHEET,
    {"name": "misplaced-sheet", "x_mm": 0.8, "y_mm": -0.6, "rotation_deg": 2.0},
)
_WAY_BACK: tuple[dict[str, Any], ...] = (
    {"name": "unloading-spike", "size": 0.1, "decay_s": 3.0},
    {"name": "hysteresis", "width": 0.05},
)


@dataclass(frozen=True)
class Sensors:
    """A kind of simulated sensor and how it is calibrated.

    Parameters
    ----------
    title : for people.
    count : how many of them a table is of.
    percent : carbon black by weight.
    effects : beside those of the scene ``base``.
    intercept_stderr : β of every sensor is drawn with this deviation about the assumed one, and stated so.
    strains_percent, trials : at the nine locations.
    """

    title: str
    count: int = 5
    percent: int = 8
    effects: tuple[dict[str, Any], ...] = _SHEET
    intercept_stderr: float = 0.0
    strains_percent: tuple[float, ...] = (20.0,)
    trials: int = 1


SENSORS = {
    "8wt": Sensors("8 wt%", 30),
    "hysteresis": Sensors("8 wt%, hysteresis", effects=_SHEET + _WAY_BACK),
    "9wt": Sensors("9 wt%", percent=9),
    "short": Sensors("8 wt%, 10 mm", effects=_SHORT),
    "intercept": Sensors("8 wt%, intercept", intercept_stderr=0.005),
    "misplaced": Sensors("8 wt%, misplaced", effects=_SHIFTED),
    "trials": Sensors("8 wt%, trials", 2, strains_percent=(10.0, 20.0, 30.0), trials=3),
}


@dataclass(frozen=True, eq=False)
class Observed:
    """A run as its analysis sees it, and the sheet it was made with."""

    run: RunObservation
    design: SheetDesign

    def response(self, places_mm: Array) -> Array:
        """True mean response (n,) under the head at places (n, 2)."""
        reach = self.run.record.indenter.radius_mm * np.sqrt((np.arange(6) + 0.5) / 6)
        turn = np.arange(12) * np.pi / 6
        about = np.stack([np.outer(reach, np.cos(turn)), np.outer(reach, np.sin(turn))], axis=-1).reshape(-1, 2)
        mean: Array = np.mean([self.design.response_at(places_mm + step) for step in about], axis=0)
        return mean


def observed(sensors: Sensors, seed: int) -> Observed:
    plugins, truth = discover(), _intercept(sensors, seed)
    configuration = _configuration(sensors, seed, _material(sensors, truth))
    clock = station_clock(configuration)
    bench = open_station(configuration, plugins, clock)
    try:
        record = _recorded(configuration, plan_of(configuration, plugins), bench, clock)
        design: SheetDesign = bench.frame_source.world.sheet.design  # type: ignore[attr-defined]
    finally:
        bench.close()
    reconstruction = create_plugin(
        plugins, Kind.RECONSTRUCTION, configuration.recipe.reconstruction, "[reconstruction]"
    )
    stated = replace(record, material=load_material(_material(sensors, 0.0)).value)
    return Observed(observe_run(stated, reconstruction, configuration.recipe.analysis, over_time=False), design)


def _configuration(sensors: Sensors, seed: int, material: dict[str, Any]) -> Configuration:
    station, scene, recipe = (
        copy_shipped(kind, name)
        for kind, name in (
            (DocumentKind.STATION, "simulated"),
            (DocumentKind.SCENE, "base"),
            (DocumentKind.RECIPE, "campaign"),
        )
    )
    scene["effects"] = [*scene["effects"], *sensors.effects]
    station["instruments"]["bench"]["scene"] = scene
    phases: dict[str, Any] = {phase["name"]: phase for phase in recipe["phases"]}
    phases[NINE] |= {"strains_percent": list(sensors.strains_percent), "trials": sensors.trials}
    recipe |= {"phases": [phases[name] for name in (NINE, PLACES, RANDOM)], "limits": []}
    return configuration_of(station, recipe, material, seed=seed)


def _intercept(sensors: Sensors, seed: int) -> float:
    return sensors.intercept_stderr * float(np.random.default_rng([seed, 5]).standard_normal())


def _material(sensors: Sensors, intercept: float) -> dict[str, Any]:
    """The shipped material with another intercept, stated with its standard error."""
    material = copy_shipped(DocumentKind.MATERIAL, f"cbsr-{sensors.percent}wt")
    if sensors.intercept_stderr:
        stated = {"value": intercept, "stderr": sensors.intercept_stderr, "source": "drawn"}
        material["material"]["against_stress"]["intercept"] = stated
        material["material"]["against_strain"]["intercept"] = stated
    return material


class _Station:
    """Carries out the steps of sequences on the simulated bench as the runner does, for the frames that count."""

    def __init__(self, bench: Any, clock: Clock, plan: Plan) -> None:
        self._bench, self._clock, self._plan = bench, clock, plan
        self._thickness_mm = plan.sensor_type.thickness_mm

    def phase(self, index: int, planned: PlannedPhase) -> PhaseRecord:
        self._frames: list[FrameBlock] = []
        self._samples: list[SampleBlock] = []
        self._loads: list[LoadRecord] = []
        self._times_s: list[float] = []
        self._rested_s: float | None = None
        started_s = self._clock.now()
        for step in planned.sequence.steps(self._plan.context):
            self._perform(step)
        self._finish()
        return PhaseRecord(
            index=index,
            name=planned.name,
            sequence=planned.sequence_name,
            started_s=started_s,
            ended_s=self._clock.now(),
            frames=join_frames(self._frames),
            samples=(join_samples(self._samples),),
            loads=tuple(self._loads),
            unloaded_from_s=self._rested_s,
            role=getattr(planned.sequence, "role", Role.OTHER),
        )

    def _perform(self, step: Step) -> None:
        match step:
            case FindSurface(x_mm=x_mm, y_mm=y_mm):
                self._bench.find_surface(x_mm, y_mm)
            case Press(load=load):
                self._finish()
                self._press(load)
            case Release():
                self._times_s.append(self._clock.now())
                self._bench.release()
                self._times_s.append(self._clock.now())
            case MarkUnloaded():
                self._rested_s = self._clock.now()
            case AcquireFrames(count=count):
                self._frames.append(self._bench.acquire(count))
            case Hold() as hold:
                self._hold(hold)
            case _:
                raise NotImplementedError(step)

    def _press(self, load: Load) -> None:
        self._bench.move_to(load.x_mm, load.y_mm)
        self._load, self._times_s = load, [self._clock.now()]
        self._bench.press(load.strain * self._thickness_mm, self._plan.motion.press_speed_mm_s)
        self._times_s.append(self._clock.now())

    def _hold(self, hold: Hold) -> None:
        taken_s = _FRAMES * self._bench.frame_period_s if hold.acquire else 0.0
        self._clock.sleep(hold.hold_s - taken_s)
        if not hold.acquire:
            return
        since_s = self._clock.now()
        self._frames.append(self._bench.acquire(_FRAMES))
        if len(self._times_s) == 2:  # the head is down
            self._samples.append(self._bench.samples_since(since_s))

    def _finish(self) -> None:
        if self._times_s:
            press_s, hold_s, release_s, up_s = self._times_s
            times = (press_s, hold_s, release_s, up_s, self._clock.now())
            self._loads.append(LoadRecord(len(self._loads), self._load, *times))
        self._times_s = []


def _recorded(configuration: Configuration, plan: Plan, bench: Bench, clock: Clock) -> RunRecord:
    station = _Station(bench.force_applicator, clock, plan)
    identity = RunIdentity(
        run=f"seed-{plan.seed}",
        sensor=SensorIdentity("BENCH", "", configuration.sensor_type.name),
        station=configuration.station.name,
        recipe=configuration.recipe.name,
        operator="",
        started_at=datetime(2026, 1, 1, tzinfo=UTC),
        configuration_digest=configuration.digest,
        software=(),
        instruments=bench.identities(),
    )
    phases = tuple(station.phase(index, planned) for index, planned in enumerate(plan.phases))
    return RunRecord(
        identity, plan.sensor_type, plan.material, plan.indenter, phases, EndReason.FINISHED, "", clock.now()
    )
