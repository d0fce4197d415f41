"""The batch as prior of stored runs: for each sensor, the model of the other sensors of its batch alone."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Final

from cbsr_qa.calibration.batch.kept import keep_loads, keep_members, make_loads
from cbsr_qa.calibration.batch.left_out import find_posteriors
from cbsr_qa.calibration.batch.model import learn_batch, thin
from cbsr_qa.calibration.batch.posterior import Posterior
from cbsr_qa.config.merging import BATCH_LAYOUT, digest_batch_model
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.plan.batch_model import KeptBatch, KeptSensor
from cbsr_qa.domain.results.fleet import RunLine, RunSelection
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.batch.choice import FEWEST, BatchChoice, choose_runs
from cbsr_qa.studies.batch.sensors import observe_sensor
from cbsr_qa.studies.batch.study import digest_runs

#: Members of a prior: as many as of a batch's model that is kept.
_MEMBERS: Final = 100


@dataclass(frozen=True, slots=True)
class StoredBatch:
    """Runs that models of a batch can be learned from, and what their sensors are.

    Parameters
    ----------
    runs : serial number and run of each.
    """

    runs: tuple[tuple[str, str], ...]
    batch: str
    sensor_type: str
    material: str
    head_mm: float
    radius_mm: float


def find_batch(store: Repository, selection: RunSelection, runs: Sequence[RunLine]) -> StoredBatch:
    """Find the runs of a batch that ``cbsr-qa batch model`` would learn from.

    Parameters
    ----------
    runs : runs that the batch is to be the prior of.

    Raises
    ------
    RefusedError
        If these are not of one batch, or fewer than five other sensors are left for one of them.
    """
    batches = sorted({run.batch for run in runs})
    if len(batches) > 1 or not batches[0]:
        stated = list_names([batch or "none stated" for batch in batches])
        raise RefusedError(f"the runs are of several batches or of none ({stated})", remedy="choose one by --batch")
    records, _ = choose_runs(store, BatchChoice(selection), lambda done, of: None)
    found = tuple((record.identity.sensor.serial, record.identity.run) for record in records)
    if why := explain_few_others([serial for serial, _ in found], runs):
        raise RefusedError(why, remedy="test more sensors of the batch")
    sensor_type, first = records[0].sensor_type, records[0]
    return StoredBatch(
        found,
        batches[0],
        sensor_type.name,
        first.material.name,
        first.indenter.diameter_mm,
        sensor_type.radius_mm,
    )


def explain_few_others(serials: Collection[str], runs: Sequence[RunLine]) -> str:
    """Say that fewer than five other sensors are left for one of the runs; empty if that is not so."""
    others = min(len(set(serials) - {run.serial}) for run in runs)
    if others >= FEWEST:
        return ""
    return f"{plural(others, 'other sensor')} can be learned from where a sensor is left out, and {FEWEST} are needed"


def plan_observation(url: str, run: str) -> Callable[[], list[KeptSensor]]:
    """Return the work on the loads of one run, for any process."""
    return partial(_observe, url, run)


def _observe(url: str, run: str) -> list[KeptSensor]:
    """Loads of a run; empty if they do not determine the response."""
    with open_store(url, create=False) as store:
        record = store.runs.load(run)
        try:
            loads = observe_sensor(store, record).loads
        except CbsrError:
            return []
    return [keep_loads(record.identity.sensor.serial, run, record.chain_head, loads)]


def learn_others(
    batch: StoredBatch, sensors: Sequence[KeptSensor], serials: Collection[str]
) -> Mapping[str, KeptBatch]:
    """Learn for each sensor the model of the others.

    Parameters
    ----------
    sensors : loads of all, in the order of their runs.
    serials : sensors to learn a model for; one without loads of its own gets that of all.
    """
    model = learn_batch([make_loads(sensor) for sensor in sensors], radius_mm=batch.radius_mm)
    posteriors = [posterior for _, posterior in find_posteriors(model)]

    def keep(others: Sequence[KeptSensor], posterior: Posterior) -> KeptBatch:
        kept = KeptBatch(
            layout=BATCH_LAYOUT,
            digest=digest_runs([(sensor.run, sensor.chain_head) for sensor in others]),
            content_sha256="",
            batch=batch.batch,
            sensor_type=batch.sensor_type,
            material=batch.material,
            head_mm=batch.head_mm,
            radius_mm=batch.radius_mm,
            sensors=tuple(others),
            members=keep_members(*thin(posterior, _MEMBERS)),
        )
        return replace(kept, content_sha256=digest_batch_model(asdict(kept)))

    models = {
        sensor.serial: keep([*sensors[:number], *sensors[number + 1 :]], posterior)
        for number, (sensor, posterior) in enumerate(zip(sensors, posteriors, strict=True))
    }
    every = keep(sensors, model.posterior)
    return {serial: models.get(serial, every) for serial in serials}
