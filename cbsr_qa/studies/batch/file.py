"""The model of a batch as it is kept: in a database, and as a JSON file that holds all a run needs to use it."""

import json
from dataclasses import asdict, replace
from pathlib import Path

from cbsr_qa.calibration.batch.kept import keep_loads, keep_members
from cbsr_qa.config.merging import BATCH_LAYOUT, digest_batch_model
from cbsr_qa.config.paths import batch_file, writable_folder
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.batch_model import KeptBatch
from cbsr_qa.studies.batch.study import LEVEL, BatchStudy
from cbsr_qa.system.files import write_atomically, writing


def write_model(study: BatchStudy, path: Path | None) -> Path:
    """Write a model's file, whole or not at all, and return its path.

    Parameters
    ----------
    path : file that must not exist yet; None for the folder of batches, where an equal model stays as it is.

    Raises
    ------
    RefusedError
        If the file exists, or its folder cannot be written to.
    """
    kept = keep_model(study)
    if path is not None:
        check_new(path)
    else:
        path = batch_file(kept.batch, kept.content_sha256)
        writable_folder(path.parent)
        if path.exists():
            path.touch()  # runs take the model that was learned last
            return path
    with writing(path), write_atomically(path) as file:
        file.write(json.dumps(asdict(kept), indent=1, ensure_ascii=False).encode())
    return path


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
        keep_loads(sensor.serial, sensor.run, sensor.chain_head, pressed)
        for sensor, pressed in zip(study.sensors, loads.sensors, strict=True)
    )
    kept = KeptBatch(
        layout=BATCH_LAYOUT,
        digest=study.digest,
        content_sha256="",
        batch=study.batch,
        sensor_type=study.sensor_type,
        material=study.material,
        head_mm=study.head_mm,
        radius_mm=study.model.radius_mm,
        sensors=sensors,
        members=keep_members(study.model.choices, study.model.weights),
        level_drift=next(
            (quantity.drift for quantity in study.quantities if quantity.name == LEVEL and quantity.drifts), 0.0
        ),
        relaxation=study.relaxation,
    )
    return replace(kept, content_sha256=digest_batch_model(asdict(kept)))
