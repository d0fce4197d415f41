"""Press cycles on the shipped strip, on the simulated bench, kept in memory."""

from dataclasses import replace
from datetime import UTC, datetime

from cbsr_qa.config.loader import load_material, load_scene, load_sensor_type, load_station
from cbsr_qa.domain.plan.plan import InstrumentSpec, PluginChoice
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.station.bench import open_bench
from cbsr_qa.station.documents import MemoryJournal
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import Plan, PlannedPhase
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa_plugins.sequences.characterisation import CharacterisationSequence


def strip_run(*, effects=(), without=(), seed=1, material="cbsr-8wt", compliance=0.05, **options):
    """Run press cycles on the shipped strip; effects are added to those of its scene, or taken out."""
    station, sensor = load_station("simulated-strip").value, load_sensor_type("strip-40x20mm").value
    material, scene = load_material(material).value, load_scene("strip").value
    kept = tuple(choice for choice in scene.effects if choice.name not in without)
    scene = replace(scene, effects=(*kept, *(PluginChoice(name, given) for name, given in effects)))
    plugins, clock = discover(), VirtualClock(datetime(2026, 1, 1, tzinfo=UTC))
    context = StationContext(
        "bench", clock, sensor, material, station.indenter, seed, {}, scene,
        lambda name: plugins.factory(Kind.EFFECT, name), motion=station.motion,
    )  # fmt: skip
    spec = InstrumentSpec("bench", "simulated-bench", ("frame_source", "force_applicator", "force"), {}, None)
    factory = plugins.factory(Kind.INSTRUMENT, "simulated-bench")
    bench = open_bench([spec], lambda _: factory(context))
    sequence = CharacterisationSequence(**{"strains_percent": [10.0, 20.0, 30.0], "cycles": 3, **options})
    phase = PlannedPhase("press cycles", "characterisation", sequence)
    safety = replace(station.safety, compliance=compliance)
    plan = Plan((phase,), sensor, material, station.indenter, station.motion, safety, seed)
    identity = RunIdentity(
        "run", SensorIdentity("S", "", sensor.name), "test", "test", "", clock.wall(), "", (), bench.identities()
    )
    journal = MemoryJournal(plan)
    ended = execute(plan, identity, bench, clock, [journal])
    assert not ended.detail, ended.detail
    return journal.record(identity, ended)
