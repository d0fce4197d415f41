"""Simulated runs kept in memory: what the run analysis is held against the truth with."""

import hashlib
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache

from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.config.loader import load_material, load_recipe, load_scene, load_sensor_type
from cbsr_qa.domain.plan.plan import InstrumentSpec, Motion, SafetyLimits
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release
from cbsr_qa.domain.readings.loads import Indenter, Load
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.sensor.sensor_type import Parameter, SensorIdentity
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.station.bench import open_bench
from cbsr_qa.station.documents import MemoryJournal
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import Plan, PlannedPhase
from cbsr_qa.system.clock import VirtualClock

HEAD = Indenter(13.0)
_MOTION = Motion(40 / 60, 10.0, 25.0)
# Whatever a scene does to the readings, its runs go on: tests look at what comes of them.
_SAFETY = SafetyLimits(40.0, 0.35, 41.0, 36_000.0, 2.0, compliance=1.0)


class Presses:
    """A sequence of presses after unloaded frames."""

    def __init__(self, loads, hold_s, rest_s):
        self._loads, self._hold_s, self._rest_s = loads, hold_s, rest_s

    def steps(self, context):
        """Find every surface, rest, take unloaded frames, then press in turn."""
        for load in self._loads:
            yield FindSurface(load.x_mm, load.y_mm)
        yield Hold(240.0, acquire=False)
        yield MarkUnloaded()
        yield AcquireFrames(20)
        for load in self._loads:
            yield Press(load)
            yield Hold(self._hold_s, acquire=True)
            yield Release()
            yield Hold(self._rest_s, acquire=True)


def simulated_run(
    places_mm,
    *,
    strain=0.2,
    hold_s=60.0,
    rest_s=60.0,
    scene="base",
    gauge=1.0,
    seed=1,
    noise=None,
    loads=None,
    phases=None,
    material=None,
    sensor=None,
):
    """Run presses on the simulated bench; ``gauge`` scales the material's response, ``noise`` replaces its own.

    ``material`` is the shipped 8 wt%, ``sensor`` the 100 mm disc unless another is given.

    ``loads`` are pressed instead of ``places_mm`` once at ``strain``; or ``phases`` are run instead of either.
    """
    material = material or load_material("cbsr-8wt").value
    against = material.against_strain
    slope = replace(against.slope, value=gauge * against.slope.value)
    material = replace(material, against_strain=replace(against, slope=slope))
    if noise is not None:
        material = replace(material, relative_noise=Parameter(noise, None, "test"))
    sensor = sensor or load_sensor_type("disc-100mm").value
    plugins, clock = discover(), VirtualClock(datetime(2026, 1, 1, tzinfo=UTC))
    context = StationContext(
        "bench", clock, sensor, material, HEAD, seed, {}, load_scene(scene).value,
        lambda name: plugins.factory(Kind.EFFECT, name), motion=_MOTION,
    )  # fmt: skip
    spec = InstrumentSpec("bench", "simulated-bench", ("frame_source", "force_applicator", "force"), {}, None)
    factory = plugins.factory(Kind.INSTRUMENT, "simulated-bench")
    bench = open_bench([spec], lambda _: factory(context))
    if loads is None:
        loads = tuple(Load(f"L{i}", x, y, strain, 0) for i, (x, y) in enumerate(places_mm))
    planned = phases or (PlannedPhase("grid", "presses", Presses(loads, hold_s, rest_s)),)
    plan = Plan(planned, sensor, material, HEAD, _MOTION, _SAFETY, seed)
    identity = RunIdentity(
        "run", SensorIdentity("S", "", sensor.name), "test", "test", "", clock.wall(), "", (), bench.identities()
    )
    journal = MemoryJournal(plan)
    ended = execute(plan, identity, bench, clock, [journal])
    assert not ended.detail, ended.detail
    return journal.record(identity, ended)


def observed_run(record, *, over_time=True, **changes):
    """What the recipe of nine locations observes in a run, with some of its settings changed."""
    recipe = load_recipe("nine-locations").value
    return observe_run(record, recipes_method(), replace(recipe.analysis, **changes), over_time=over_time)


@cache
def recipes_method():
    """The recipe's reconstruction, which prepares the matrix of a problem once: that takes a second."""
    recipe = load_recipe("nine-locations").value
    method = discover().factory(Kind.RECONSTRUCTION, recipe.reconstruction.name)(**recipe.reconstruction.options)
    prepare, prepared = method.prepare, {}

    def prepare_once(problem):
        arrays = (problem.jacobian, problem.reference, problem.used, problem.noise_variance)
        key = tuple(None if array is None else hashlib.sha256(array.tobytes()).digest() for array in arrays)
        if key not in prepared:
            prepared[key] = prepare(problem)
        return replace(prepared[key], problem=problem)

    method.prepare = prepare_once
    return method
