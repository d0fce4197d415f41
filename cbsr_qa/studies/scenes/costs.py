"""Cost of a scene's effects, measured on frames of its own recording."""

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, wraps
from statistics import mean, median
from typing import Any, Final

import numpy as np

from cbsr_qa.domain.plan.scene_plan import SceneLoad, ScenePlan, approach_s, press_times
from cbsr_qa.plugin.interfaces import AnyEffect
from cbsr_qa.simulate.chain import EffectFactory
from cbsr_qa.simulate.recording import SAMPLE_RATE_HZ, frame_middles_s, press_loads
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.studies.scenes.setting import SceneSetup, make_world, name_scene_file

#: Stages that affect how much is solved: their effects cost more than the time within them.
SOLVED_STAGES: Final = ("sheet", "times", "response", "contacts")
_FRAMES: Final = 5  # number of frames for a median
_REPEATS: Final = 4
#: Time of this process alone, independent of the computer's other load; on Windows it has steps of 15.6 ms, longer
#: than a frame takes.
_clock_s: Final = time.perf_counter if sys.platform == "win32" else time.process_time
_STAND_IN: Final = SceneLoad(0.0, 0.0, 0.2, 0.0, 30.0)  # for scenes that run at a station


@dataclass(frozen=True, slots=True)
class Costs:
    """Measured costs of a scene's effects.

    Parameters
    ----------
    effect_ms : time per frame of each enabled effect, with its share of work done once per scene.
    each_ms : the same times without that share.
    once_ms : total work once per scene: when the sheet is made, when heads move, before frames are written.
    frame_ms : time of a whole frame during a load, with its force samples.
    compute_s : estimate for the whole recording.
    """

    effect_ms: dict[str, float]
    each_ms: dict[str, float]
    once_ms: dict[str, float]
    frame_ms: float
    compute_s: float


class Watched:
    """An effect factory that records the effects it makes, and the time spent in them."""

    def __init__(self, effect_factory: EffectFactory) -> None:
        self._factory = effect_factory
        self.effects: dict[str, AnyEffect] = {}
        self.spent_s: dict[str, float] = {}

    def __call__(self, name: str) -> Callable[..., Any]:
        """Find a factory and watch its effects."""
        factory = self._factory(name)

        @wraps(factory, updated=())  # a chain inspects its signature
        def make(*setting: Any, **parameters: Any) -> Any:
            effect = factory(*setting, **parameters)
            self.effects[name] = effect
            self.spent_s[name] = 0.0
            for method in ("apply", "design", "record"):
                if hasattr(effect, method):
                    with suppress(AttributeError):  # an effect with slots cannot be watched
                        setattr(effect, method, self._time_method(name, getattr(effect, method)))
            return effect

        return make

    def _time_method(self, name: str, method: Callable[[Any], None]) -> Callable[[Any], None]:
        def call_timed(changed: Any) -> None:
            start_s = _clock_s()
            method(changed)
            self.spent_s[name] += _clock_s() - start_s

        return call_timed

    def time_call(self, work: Callable[[], object]) -> dict[str, float]:
        """Call a function and return the time spent within each effect [s]."""
        spent_before_s = dict(self.spent_s)
        work()
        return {name: spent - spent_before_s.get(name, 0.0) for name, spent in self.spent_s.items()}


def measure_costs(
    setup: SceneSetup,
    effect_factory: EffectFactory,
    *,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Costs:
    """Measure on a few frames, spread over the recording, during loads.

    An effect costs the time within it; work done once per scene (the sheet, the head's movements, losses) is
    distributed over its frames. An effect that changes how much is solved costs at least the difference between
    frames with it and frames without it and its dependents.

    ConfigError if a frame cannot be taken, with the scene's file.
    """
    plan = plan_recording(setup)
    watched = Watched(effect_factory)
    with name_scene_file(setup.label):
        bench = _Bench(setup, plan, watched, effect_factory)
        each_ms, once_ms = bench.within_ms(), bench.once_ms()
        shared_ms = {name: each_ms[name] + once_ms[name] / max(plan.frame_count, 1) for name in each_ms}
        names = [name for name, effect in watched.effects.items() if effect.perturbs in SOLVED_STAGES]
        for count, name in enumerate(names, start=1):
            difference_ms = bench.difference_ms(name)
            each_ms[name] = max(each_ms[name], difference_ms)
            shared_ms[name] = max(shared_ms[name], difference_ms)
            progress(count, len(names))
        return Costs(shared_ms, each_ms, once_ms, bench.frame_ms(), bench.compute_s())


def plan_recording(setup: SceneSetup) -> ScenePlan:
    """Return the scene's plan; for a station's scene, with a substitute recording and load."""
    plan = setup.plan
    if plan.duration_s is not None:
        return plan
    x_mm, y_mm = setup.sensor_type.value.outline.centre_mm
    loads = plan.loads or (replace(_STAND_IN, x_mm=x_mm, y_mm=y_mm, start_s=20.0 + approach_s(plan.motion)),)
    thickness_mm = setup.sensor_type.value.thickness_mm
    end_s = max(press_times(load, load.strain * thickness_mm, plan.motion).up_s for load in loads)
    return replace(plan, loads=loads, seed=0, duration_s=end_s + plan.scene.frame_period_s)


class _Bench:
    """A scene's world with its loads pressed, watched or not, and its frames."""

    def __init__(self, setup: SceneSetup, plan: ScenePlan, watched: Watched, effect_factory: EffectFactory) -> None:
        self._setup, self._plan, self._watched = setup, plan, watched
        self._factory = effect_factory
        self._once: list[dict[str, float]] = []
        begun_s = _clock_s()
        self._seen = self._world(plan, watched)
        self._once.append(dict(watched.spent_s))  # while the sheet was made
        self._once.append(watched.time_call(lambda: self._seen.transcript(frame_middles_s(plan))))
        end_s = plan.frame_count * plan.scene.frame_period_s
        self._once.append(watched.time_call(lambda: press_loads(self._seen, plan, end_s)))
        self._setup_s = _clock_s() - begun_s
        self._plain = self._world(plan, effect_factory, like=self._seen)
        self._loaded = _choose_frames(plan, setup.sensor_type.value.thickness_mm)

    def _world(
        self, plan: ScenePlan, factory: EffectFactory, like: SimulatedWorld | None = None, *, same_sheet: bool = True
    ) -> SimulatedWorld:
        sheet = like.sheet if like is not None and same_sheet else None
        world = make_world(self._setup, factory, seed=plan.seed or 0, plan=plan, sheet=sheet)
        if like is not None:
            world.presses = like.presses
        return world

    def within_ms(self) -> dict[str, float]:
        """Time per frame within each effect."""
        frames = [self._watched.time_call(partial(self._take_frame, self._seen, index)) for index in self._loaded]
        return {name: 1e3 * median(spent_s[name] for spent_s in frames) for name in self._watched.effects}

    def once_ms(self) -> dict[str, float]:
        """Total time within each effect outside frames."""
        return {name: 1e3 * sum(once.get(name, 0.0) for once in self._once) for name in self._watched.effects}

    def difference_ms(self, name: str) -> float:
        """Difference between frames with an effect and without it and its dependents; 0 if unclear."""
        effects = self._watched.effects
        left_out = _with_dependents(name, effects)
        kept_effects = tuple(choice for choice in self._plan.scene.effects if choice.name not in left_out)
        plan = replace(self._plan, scene=replace(self._plan.scene, effects=kept_effects))
        same_sheet = not any(effects[effect_name].perturbs == "sheet" for effect_name in left_out)
        other = self._world(plan, self._factory, self._plain, same_sheet=same_sheet)
        return 1e3 * _clear([_measure_difference_s(self._plain, other, self._times(index)) for index in self._loaded])

    def frame_ms(self) -> float:
        """Time of a whole frame during a load, and of its force samples."""
        return 1e3 * median(self._measure_frame_s(index) for index in self._loaded)

    def compute_s(self) -> float:
        """Time of the whole recording, extrapolated from frames spread over it."""
        count = self._plan.frame_count
        spread = np.unique(np.linspace(0, count - 1, 2 * _FRAMES).astype(int)).tolist()
        return self._setup_s + count * mean(self._measure_frame_s(index) for index in spread)

    def _times(self, index: int) -> tuple[float, int]:
        return (index + 0.5) * self._plan.scene.frame_period_s, index

    def _measure_frame_s(self, index: int) -> float:
        self._plain.frame(*self._times(index))  # caches between frames of one place are filled
        start_s = _clock_s()
        self._take_frame(self._plain, index)
        return _clock_s() - start_s

    def _take_frame(self, world: SimulatedWorld, index: int) -> None:
        world.frame(*self._times(index))
        period_s = self._plan.scene.frame_period_s
        first, last = (int(each * period_s * SAMPLE_RATE_HZ) for each in (index, index + 1))
        for number in range(first, last):
            world.force_N(number / SAMPLE_RATE_HZ, number)


def _clear(differences_s: list[float]) -> float:
    """Median of differences between frames; zero if they are noise.

    More work cannot make a frame shorter: negative differences show the size of the noise.
    """
    middle_s, noise_s = median(differences_s), -min(differences_s)
    return middle_s if middle_s > 2 * noise_s else 0.0


def _measure_difference_s(world: SimulatedWorld, other: SimulatedWorld, at: tuple[float, int]) -> float:
    """Difference between the times of a frame in two worlds.

    Tries alternate, so that a slowing computer affects both; the shortest of each counts, after a warm-up.
    """
    tries_s: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(1 + _REPEATS):
        for is_first_world in (True, False):
            start_s = _clock_s()
            (world if is_first_world else other).frame(*at)
            tries_s[is_first_world].append(_clock_s() - start_s)
    return min(tries_s[True][1:]) - min(tries_s[False][1:])


def _with_dependents(name: str, effects: dict[str, AnyEffect]) -> set[str]:
    """An effect and all its direct and indirect dependents, which come after it."""
    dependents = {name}
    for other, effect in effects.items():
        if dependents & set(effect.needs):
            dependents.add(other)
    return dependents


def _choose_frames(plan: ScenePlan, thickness_mm: float) -> Sequence[int]:
    """A few frames in the middle of holds, or spread over the recording."""
    times = [press_times(load, load.strain * thickness_mm, plan.motion) for load in plan.loads]
    middles = sorted((press.down_s + press.lifts_s) / 2 for press in times)
    frames: Iterable[int] = (int(middle / plan.scene.frame_period_s) for middle in middles)
    loaded = sorted({min(frame, plan.frame_count - 1) for frame in frames}) or range(plan.frame_count)
    return [loaded[int(k)] for k in np.unique(np.linspace(0, len(loaded) - 1, _FRAMES).astype(int))]
