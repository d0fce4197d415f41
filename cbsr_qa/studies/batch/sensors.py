"""What a stored run says about its sensor: loads for the map, and how it relaxes."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cbsr_qa.analysis.run.compensation import LONG
from cbsr_qa.analysis.run.force import RunForce, learn_without_tests
from cbsr_qa.analysis.run.long_holds import LongHolds, find_long_holds
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.calibration.batch.loads import SensorLoads
from cbsr_qa.calibration.file.hdf5 import calibration_of
from cbsr_qa.calibration.sheet.response_map import intercept_column
from cbsr_qa.config.merging import RECIPE_KEYS, canonical_json, restore_recipe
from cbsr_qa.domain.plan.plan import Recipe
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.json_text import parse_json


@dataclass(frozen=True, slots=True, eq=False)
class StoredSensor:
    """One sensor of the batch.

    Parameters
    ----------
    loads : what its map is learned from.
    settling_s : settling times of its calibration, by signal and whether after a press.
    holds : its longest holds; None where they are not known, or are shorter than those of the batch's relaxation
        that the run borrowed: they say nothing of it.
    prior : digest of the batch's model that the run took as prior; empty without one.
    """

    record: RunRecord
    loads: SensorLoads
    settling_s: dict[tuple[str, bool], float]
    holds: LongHolds | None = None
    prior: str = ""


def observe_sensor(store: Repository, record: RunRecord) -> StoredSensor:
    """Learn what a run says about its sensor.

    The response is that of each press by itself: a prior that the run had for its map has no part in it.

    Raises
    ------
    CbsrError
        If the run cannot be imaged, or fewer than three loads determine the response.
    """
    configuration = parse_json(store.runs.read_configuration(record.identity.run))
    recipe, method = _load_recipe(
        canonical_json({key: configuration[key] for key in RECIPE_KEYS if key in configuration})
    )
    observation = observe_run(record, method, recipe.analysis, over_time=False)
    loads = map_loads(observation, learn_without_tests(observation))
    holds, prior = find_long_holds(observation), recipe.analysis.batch
    has_borrowed = prior is not None and prior.relaxation and holds.hold_s < LONG * prior.relaxation.hold_s
    return StoredSensor(
        record,
        loads,
        _load_settling(store, record),
        None if has_borrowed else holds,
        "" if prior is None else prior.digest,
    )


def map_loads(run: RunObservation, force: RunForce) -> SensorLoads:
    """What a run's map of the response was learned from."""
    assert force.learned is not None
    used = np.array([not why for why in force.learned.refused])
    loads = [load for load, is_used in zip(force.used, used, strict=True) if is_used]
    stress = np.array([load.force_N for load in loads], dtype=np.float64) / run.record.indenter.area_mm2 * 1e3
    line = run.record.material.against_stress
    bend, stderr, _ = intercept_column(line, stress, line.slope.value * stress + line.intercept.value)
    ratio, error = force.learned.ratio[used], force.learned.ratio_stderr[used]
    places_mm = force.sheet_pose.places_mm(np.array([load.place_mm for load in loads]))
    return SensorLoads(places_mm, np.log(ratio), (error / ratio) ** 2, bend, stderr)


@lru_cache(maxsize=4)
def _load_recipe(canonical: str) -> tuple[Recipe, Reconstruction]:
    recipe = restore_recipe(parse_json(canonical))
    method: Reconstruction = create_plugin(discover(), Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]")
    return recipe, method


def _load_settling(store: Repository, record: RunRecord) -> dict[tuple[str, bool], float]:
    """Settling times of the calibration that the run issued; empty without one."""
    issued = store.analyses.load(record.identity.run)[0].calibration
    if issued is None:
        return {}
    file, digest = store.calibrations.load_file(issued)
    return {
        (summary.signal, summary.loading): summary.mean_s
        for summary in calibration_of(file, issued=digest).settling
        if summary.mean_s is not None
    }
