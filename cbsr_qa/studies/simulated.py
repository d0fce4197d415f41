"""Simulated sensors of studies: modifiable shipped documents, and whole runs in memory."""

import copy
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type, load_station
from cbsr_qa.config.merging import Configuration, merge
from cbsr_qa.domain.run.run import RunIdentity, RunRecord
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.station.bench import Bench
from cbsr_qa.station.decider import RunDecider
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.documents import MemoryJournal
from cbsr_qa.station.execution import Decider, execute
from cbsr_qa.station.plan import Plan
from cbsr_qa.station.setup import open_station, plan_of, station_clock


def copy_shipped(kind: DocumentKind, name: str) -> dict[str, Any]:
    """Return a modifiable copy of a shipped document."""
    return copy.deepcopy(dict(open_document(kind, name).data))


def configuration_of(
    station: Mapping[str, Any],
    recipe: Mapping[str, Any],
    material: str | Mapping[str, Any] | None = None,
    *,
    seed: int,
) -> Configuration:
    """Merge documents of a simulated station; the material is the station's by default."""
    loaded_station = load_station(dict(station))
    chosen = loaded_station.value.material if material is None else material
    loaded_material = load_material(chosen if isinstance(chosen, str) else dict(chosen))
    return merge(
        loaded_station,
        load_recipe(dict(recipe)),
        load_sensor_type(loaded_station.value.sensor_type),
        loaded_material,
        seed=seed,
    )


def simulate_run(
    configuration: Configuration, serial: str, plugins: Plugins, change: Callable[[Plan], Plan] = lambda plan: plan
) -> tuple[RunRecord, Bench]:
    """Run a recipe at its simulated station; nothing is stored.

    Parameters
    ----------
    change : modifies the plan before the run.

    Returns
    -------
    The run, finished or not, and its bench, which is closed.
    """
    plan, clock = change(plan_of(configuration, plugins)), station_clock(configuration)
    bench = open_station(configuration, plugins, clock)
    try:
        instruments = bench.identities()
        identity = RunIdentity(
            run=serial,
            sensor=SensorIdentity(serial, "", configuration.sensor_type.name),
            station=configuration.station.name,
            recipe=configuration.recipe.name,
            operator="",
            started_at=datetime(2026, 1, 1, tzinfo=UTC),
            configuration_digest=configuration.digest,
            software=software_versions(plugins),
            instruments=instruments,
            simulated=tuple(
                f"{instrument.role}: {instrument.model}" for instrument in instruments if instrument.simulated
            ),
        )
        journal, decider = MemoryJournal(plan), _decider(configuration, plan, plugins)
        return journal.record(identity, execute(plan, identity, bench, clock, [journal], decider=decider)), bench
    finally:
        bench.close()


def _decider(configuration: Configuration, plan: Plan, plugins: Plugins) -> Decider | None:
    """What decides between presses, if a sequence of the plan asks for it."""
    if not plan.decides:
        return None
    return RunDecider(PressDecisions.from_configuration(configuration, plan, plugins), plan)
