"""The study of a batch: its model, each sensor beside the others, scatter and drift."""

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import Field, InstanceOf
from scipy import stats

from cbsr_qa.calibration.batch.left_out import leave_each_out
from cbsr_qa.calibration.batch.model import BatchModel, Share, learn_batch
from cbsr_qa.calibration.batch.prior import Likeness
from cbsr_qa.calibration.batch.sensor_map import BatchMap
from cbsr_qa.config.merging import canonical_json
from cbsr_qa.config.paths import database_url
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.batch_model import KeptRelaxation
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.stats.difference import holm
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.batch.choice import BatchChoice, LeftOutRun, choose_runs, refuse_few
from cbsr_qa.studies.batch.relaxation import learn_relaxation
from cbsr_qa.studies.batch.sensors import StoredSensor, observe_sensor

#: Number of the method: part of the digest, so that another method's models differ.
METHOD: Final = 1
#: Adjusted p below which a sensor stands out, and a drift is named.
STANDS_OUT: Final = 0.05
#: Name of the level among the quantities.
LEVEL: Final = "level of the response"
_CONFIDENCE: Final = 0.95
_SEED: Final = re.compile(r", seed \d+$")
_SPACING: Final = 31  #: places a side of the lattice over the pressed area
_PRESSES: Final = (0, 4, 9, 16)  #: numbers of presses whose error is stated


@dataclass(frozen=True, slots=True)
class SensorOfBatch:
    """One sensor beside the others.

    Parameters
    ----------
    run, chain_head : the run the model rests on, and the digest of the last link of its chain.
    loads : number of loads.
    level, level_stderr : mean response of its map over the pressed area, relative to the mean of all sensors.
    deviation : root mean square of its map about the others' common one, its level included.
    p_value : probability that a sensor like the others has an evidence as low.
    log_evidence : logarithm of the Bayes factor of "like the others" over "of another batch".
    stands_out : whether p, adjusted for all sensors (Holm), is below 0.05.
    prior : digest of the batch's model that its run took as prior; empty without one. The loads are single presses
        all the same, without the map that was learned with it.
    """

    serial: str
    run: str
    chain_head: str
    loads: int
    level: float
    level_stderr: float
    deviation: float
    p_value: float
    log_evidence: float
    stands_out: bool
    prior: str


@dataclass(frozen=True, slots=True)
class BatchQuantity:
    """Scatter of one quantity over the sensors, and its drift in the order the runs were made in.

    Parameters
    ----------
    mean, deviation : over the sensors.
    drift, drift_low, drift_high : change from one sensor to the next, with its interval of 95 % (least squares).
    drift_p : p value of no drift, adjusted for all quantities (Holm).
    """

    name: str
    unit: str
    sensors: int
    mean: float
    deviation: float
    drift: float
    drift_low: float
    drift_high: float
    drift_p: float

    @property
    def drifts(self) -> bool:
        """Whether a drift is shown."""
        return self.drift_p < STANDS_OUT


@dataclass(frozen=True, slots=True)
class ExpectedError:
    """Error that is expected of the map of one more sensor of the batch.

    Parameters
    ----------
    presses : number of presses of that sensor, at places of the batch that are far apart.
    error : root mean square of the standard error of its response, relative.
    """

    presses: int
    error: float


@dataclass(frozen=True, slots=True, eq=False)
class BatchStudy:
    """A batch's model and what it says.

    Parameters
    ----------
    rho : share of the variance of maps that two sensors have in common, with its interval of 95 %.
    map_deviation, common_deviation, level_deviation : relative deviations of maps, of the common map, and of levels.
    scatter : relative scatter of single presses beyond noise.
    length_mm : correlation length.
    expected : error of the next sensor by its presses.
    digest : SHA-256 of the method, the runs and their chains.
    relaxation : how its loads relax; None if no holds determine it.
    """

    batch: str
    sensor_type: str
    material: str
    head_mm: float
    rho: Share
    map_deviation: float
    common_deviation: float
    level_deviation: float
    scatter: float
    length_mm: float
    sensors: tuple[SensorOfBatch, ...]
    quantities: tuple[BatchQuantity, ...]
    expected: tuple[ExpectedError, ...]
    left_out: tuple[LeftOutRun, ...]
    simulated: tuple[str, ...]
    digest: str
    relaxation: Annotated[InstanceOf[KeptRelaxation] | None, Field(exclude=True)]
    model: Annotated[InstanceOf[BatchModel], Field(exclude=True)]
    maps: Annotated[tuple[InstanceOf[BatchMap], ...], Field(exclude=True)]
    places_mm: Annotated[InstanceOf[np.ndarray], Field(exclude=True)]
    shape: Annotated[InstanceOf[SensorType], Field(exclude=True)]


def study_batch(
    choice: BatchChoice,
    *,
    database: str | None,
    stage: Callable[[str], None],
    count: Callable[[int, int], None],
) -> BatchStudy:
    """Learn the model of a stored batch.

    Parameters
    ----------
    stage, count : are told the stage, and how far it is.

    Raises
    ------
    RefusedError
        As :func:`~cbsr_qa.studies.batch.choice.choose_runs`; or if all runs have borrowed their relaxation from a
        model.
    """
    with open_store(database_url(database), create=False) as store:
        sensors, left_out = _observe_runs(store, choice, stage, count)
    records = [sensor.record for sensor in sensors]
    stage("learning the batch")
    first = records[0]
    model = learn_batch([sensor.loads for sensor in sensors], radius_mm=first.sensor_type.radius_mm)
    stage("comparing each sensor with the others")
    beside = list(leave_each_out(model, count))
    maps, places_mm = tuple(found for _, found in beside), _place_lattice(model.loads.places_mm)
    levels = [found.average(places_mm) for found in maps]
    middle = float(np.mean([level for level, _ in levels]))
    choices, weights = model.posterior.choices, model.posterior.weights

    def deviation(values: Sequence[float]) -> float:
        return float(np.sqrt(weights @ np.square(values)))

    return BatchStudy(
        batch=first.identity.sensor.batch,
        sensor_type=first.sensor_type.name,
        material=first.material.name,
        head_mm=first.indenter.diameter_mm,
        rho=model.rho,
        map_deviation=deviation([float(np.hypot(one.own, one.common)) for one in choices]),
        common_deviation=deviation([one.common for one in choices]),
        level_deviation=deviation([one.level for one in choices]),
        scatter=deviation([one.scatter for one in choices]),
        length_mm=float(weights @ np.array([one.length_mm for one in choices])),
        sensors=tuple(_describe_sensors(sensors, model, beside, [(level - middle, v) for level, v in levels])),
        quantities=_describe_quantities(sensors, [level - middle for level, _ in levels]),
        expected=_expect_errors(model, places_mm),
        left_out=left_out,
        # Each part once: seeds differ from run to run.
        simulated=tuple(sorted({_SEED.sub("", part) for record in records for part in record.identity.simulated})),
        digest=digest_runs([(record.identity.run, record.chain_head) for record in records]),
        relaxation=learn_relaxation([sensor.holds for sensor in sensors if sensor.holds is not None]),
        model=model,
        maps=maps,
        places_mm=places_mm,
        shape=first.sensor_type,
    )


def _observe_runs(
    store: Repository, choice: BatchChoice, stage: Callable[[str], None], count: Callable[[int, int], None]
) -> tuple[list[StoredSensor], tuple[LeftOutRun, ...]]:
    """Choose and image the runs; leave out those whose loads do not determine a response, with the reason."""
    stage("reading the runs")
    records, left_out = choose_runs(store, choice, count)
    stage("imaging")
    sensors, silent = [], []
    for number, record in enumerate(records):
        try:
            sensors.append(observe_sensor(store, record))
        except CbsrError as error:
            silent.append(LeftOutRun(record.identity.sensor.serial, record.identity.run, error.reason))
        count(number + 1, len(records))
    refuse_few(len(sensors), (*left_out, *silent), choice)
    if all(sensor.prior and sensor.holds is None for sensor in sensors):
        raise RefusedError(
            "every run took how loads relax from an earlier model of the batch: none has measured it",
            remedy="test a sensor of the batch with a recipe that has long holds, such as adaptive",
        )
    return sensors, (*left_out, *silent)


def _describe_sensors(
    sensors: Sequence[StoredSensor],
    model: BatchModel,
    beside: Sequence[tuple[Likeness, BatchMap]],
    levels: Sequence[tuple[float, float]],
) -> Iterator[SensorOfBatch]:
    """Yield each sensor beside the others; levels with their variances."""
    places_mm = _place_lattice(model.loads.places_mm)
    common = model.prior.predict(places_mm)[0]
    adjusted = holm([likeness.p_value for likeness, _ in beside])
    for sensor, (likeness, found), (level, variance), p_value in zip(sensors, beside, levels, adjusted, strict=True):
        yield SensorOfBatch(
            serial=sensor.record.identity.sensor.serial,
            run=sensor.record.identity.run,
            chain_head=sensor.record.chain_head,
            loads=len(sensor.loads.log_response),
            level=float(np.expm1(level)),
            level_stderr=float(np.sqrt(variance)),
            deviation=float(np.sqrt(np.mean((found.predict(places_mm)[0] - common) ** 2))),
            p_value=likeness.p_value,
            log_evidence=likeness.log_evidence,
            stands_out=bool(p_value < STANDS_OUT),
            prior=sensor.prior,
        )


def digest_runs(runs: Sequence[tuple[str, str]]) -> str:
    """SHA-256 of the method, and of the runs with the heads of their chains."""
    return hashlib.sha256(
        canonical_json({"method": METHOD, "runs": [list(run) for run in runs]}).encode()
    ).hexdigest()


def _place_lattice(pressed_mm: Array) -> Array:
    """Places (n, 2) on a square lattice, no further from the middle than any press."""
    reach = float(np.hypot(*pressed_mm.T).max())
    line = np.linspace(-reach, reach, _SPACING)
    lattice = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    inside: Array = lattice[np.hypot(*lattice.T) <= reach]
    return inside


def _describe_quantities(sensors: Sequence[StoredSensor], levels: Sequence[float]) -> tuple[BatchQuantity, ...]:
    values = {(LEVEL, "1"): dict(enumerate(levels))}
    keys = sorted({key for sensor in sensors for key in sensor.settling_s})
    for signal, loading in keys:
        name = f"settling time of the {signal} after {'a press' if loading else 'a release'}"
        values[name, "s"] = {
            number: sensor.settling_s[signal, loading]
            for number, sensor in enumerate(sensors)
            if (signal, loading) in sensor.settling_s
        }
    many = {key: found for key, found in values.items() if len(found) > 2}
    lines = [stats.linregress(list(found), list(found.values())) for found in many.values()]
    adjusted = holm([float(line.pvalue) for line in lines])
    return tuple(
        BatchQuantity(
            *key,
            sensors=len(found),
            mean=float(np.mean(list(found.values()))),
            deviation=float(np.std(list(found.values()), ddof=1)),
            drift=float(line.slope),
            drift_low=float(line.slope - _factor(len(found)) * line.stderr),
            drift_high=float(line.slope + _factor(len(found)) * line.stderr),
            drift_p=float(p_value),
        )
        for (key, found), line, p_value in zip(many.items(), lines, adjusted, strict=True)
    )


def _factor(count: int) -> float:
    return float(stats.t.ppf((1 + _CONFIDENCE) / 2, count - 2))


def _expect_errors(model: BatchModel, places_mm: Array) -> tuple[ExpectedError, ...]:
    pressed = _spread_places(model.loads.places_mm)
    counts = sorted({count for count in _PRESSES if count < len(pressed)} | {len(pressed)})
    errors = [float(np.sqrt(model.prior.expect_variance(pressed[:count], places_mm).mean())) for count in counts]
    return tuple(ExpectedError(count, error) for count, error in zip(counts, errors, strict=True))


def _spread_places(places_mm: Array) -> Array:
    """Places in an order in which the first are far apart: the innermost, then the farthest from those before."""
    chosen = [int(np.argmin(np.hypot(*places_mm.T)))]
    distance = np.hypot(*(places_mm - places_mm[chosen[0]]).T)
    while len(chosen) < len(places_mm):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.hypot(*(places_mm - places_mm[chosen[-1]]).T))
    return places_mm[chosen]
