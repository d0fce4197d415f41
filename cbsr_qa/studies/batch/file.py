"""The file of a batch's model: JSON that holds all a run needs to use it."""

import hashlib
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads, SensorLoads
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.config.merging import canonical_json
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_mapping
from cbsr_qa.domain.results.batch import KeptBatch, KeptMember, KeptSensor
from cbsr_qa.studies.batch.study import BatchStudy
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.system.json_text import parse_json

_LAYOUT: Final = 1
#: Size above that of any model's file [bytes].
_MOST_BYTES: Final = 2**26


def write_model(study: BatchStudy, path: Path) -> None:
    """Write a model's file, whole or not at all. RefusedError if it exists, or its folder cannot be written to."""
    check_new(path)
    kept = keep_model(study)
    with writing(path), write_atomically(path) as file:
        file.write(json.dumps(asdict(kept), indent=1, ensure_ascii=False).encode())


def check_new(path: Path) -> None:
    """Refuse to write over a file."""
    with writing(path):
        exists = path.exists()
    if exists:
        raise RefusedError(f"{path} exists already", remedy="name another file: runs may rest on this model")


def keep_model(study: BatchStudy) -> KeptBatch:
    """Return what is kept of a batch's model."""
    loads = study.model.loads
    sensors = tuple(
        KeptSensor(
            serial=sensor.serial,
            run=sensor.run,
            chain_head=sensor.chain_head,
            places_mm=tuple((x, y) for x, y in pressed.places_mm.tolist()),
            log_response=tuple(pressed.log_response.tolist()),
            variance=tuple(pressed.variance.tolist()),
            bend=None if pressed.bend is None else tuple(pressed.bend.tolist()),
            bend_stderr=pressed.bend_stderr,
        )
        for sensor, pressed in zip(study.sensors, loads.sensors, strict=True)
    )
    members = tuple(
        KeptMember(**asdict(choice), weight=weight)
        for choice, weight in zip(study.model.choices, study.model.weights, strict=True)
    )
    kept = KeptBatch(
        layout=_LAYOUT,
        digest=study.digest,
        content_sha256="",
        batch=study.batch,
        sensor_type=study.sensor_type,
        material=study.material,
        head_mm=study.head_mm,
        radius_mm=study.model.radius_mm,
        sensors=sensors,
        members=members,
    )
    return replace(kept, content_sha256=_digest_content(asdict(kept)))


def read_model(path: Path) -> KeptBatch:
    """Read a model's file.

    RefusedError if it cannot be read, is of another layout, or was changed.
    """
    try:
        content = parse_json(read_foreign(path, _MOST_BYTES))
        kept = fill_from_mapping(KeptBatch, content)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        why = getattr(error, "strerror", None) or "it is not the file of a batch's model"
        raise RefusedError(
            f"{path} cannot be read: {why}", remedy="cbsr-qa batch model --to FILE writes one"
        ) from error
    if kept.layout != _LAYOUT:
        raise RefusedError(f"{path} is of layout {kept.layout}; this version reads {_LAYOUT}")
    if _digest_content(content) != kept.content_sha256:
        raise RefusedError(f"{path} was changed: its content is not that of its SHA-256", remedy="write it again")
    return kept


def make_prior(kept: KeptBatch) -> BatchPrior:
    """Return the prior of a further sensor by a kept model."""
    sensors = [
        SensorLoads(
            np.array(sensor.places_mm, dtype=np.float64).reshape(-1, 2),
            np.array(sensor.log_response),
            np.array(sensor.variance),
            None if sensor.bend is None else np.array(sensor.bend),
            sensor.bend_stderr,
        )
        for sensor in kept.sensors
    ]
    choices = [
        Hyperparameters(one.smooth, one.length_mm, one.scatter, one.own, one.common, one.level)
        for one in kept.members
    ]
    return BatchPrior(BatchLikelihood(BatchLoads(sensors)), choices, [member.weight for member in kept.members])


def _digest_content(content: dict[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != "content_sha256"}
    return hashlib.sha256(canonical_json(parse_json(json.dumps(rest))).encode()).hexdigest()
