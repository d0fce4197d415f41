"""The batch's model that a run takes as prior: found, and checked against the run before anything moves."""

from contextlib import nullcontext
from pathlib import Path
from typing import Final

from cbsr_qa.calibration.batch.kept import make_prior
from cbsr_qa.config.merging import Configuration, add_batch_model, read_model_file
from cbsr_qa.config.paths import batches_folder
from cbsr_qa.domain.errors import CalibrationError, RefusedError
from cbsr_qa.domain.plan.batch_model import KeptBatch
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.opening import open_existing

#: Drift of the level since the model's last sensor, over the deviation of levels, from which a model is too old.
_MOST_DRIFT: Final = 1.0


def add_prior(configuration: Configuration, batch: str, file: Path | None, database: str) -> Configuration:
    """Return the configuration of a run with the model of its sensor's batch.

    Parameters
    ----------
    batch : batch of the sensor; may be empty if a file is given.
    file : the model's file; None for the one in the folder of batches that was learned last.
    database : where the runs are stored that came after the model's.

    Raises
    ------
    RefusedError
        If there is no model of the batch, none fits the run, one of its numbers is impossible, or the batch has
        drifted since.
    """
    fitting = _find_model(configuration, batch) if file is None else read_model_file(file)
    why = _explain_misfit(fitting, configuration, batch)
    if why:
        raise RefusedError(f"the batch's model {fitting.digest[:16]} {why}", remedy="learn one of this batch")
    try:
        make_prior(fitting)
    except CalibrationError as error:
        raise RefusedError(
            f"the batch's model {fitting.digest[:16]} cannot be used: {error.reason}", remedy="learn it again"
        ) from error
    _check_age(fitting, database)
    return add_batch_model(configuration, fitting)


def _find_model(configuration: Configuration, batch: str) -> KeptBatch:
    """Return the model of a batch that was learned last and fits the run, whatever was left out of it."""
    if not batch:
        raise RefusedError(
            f"recipe {configuration.recipe.name!r} takes the batch as prior, and the sensor's batch is not named",
            remedy="give --batch, or --batch-model FILE",
        )
    folder = batches_folder()
    paths = sorted(folder.glob("*.json"), key=lambda path: path.stat().st_mtime_ns) if folder.is_dir() else []
    of_batch = [model for model in map(read_model_file, paths) if model.batch == batch]
    fitting = [model for model in of_batch if not _explain_misfit(model, configuration, batch)]
    if not fitting:
        why = f": one {_explain_misfit(of_batch[-1], configuration, batch)}" if of_batch else ""
        raise RefusedError(
            f"no model of batch {batch!r} in {folder} fits this run{why}",
            remedy=f"learn one from at least five sensors that passed: cbsr-qa batch model --batch {batch}",
        )
    return fitting[-1]


def _explain_misfit(model: KeptBatch, configuration: Configuration, batch: str) -> str:
    """Say in what a model is not of the run; empty if it fits."""
    head_mm = configuration.station.indenter.diameter_mm
    facts = (
        ("batch", model.batch, batch or model.batch),
        ("sensor type", model.sensor_type, configuration.sensor_type.name),
        ("material", model.material, configuration.material.name),
        ("head", f"{model.head_mm:g} mm", f"{head_mm:g} mm"),
    )
    return next((f"is of {what} {its}, and the run of {of_run}" for what, its, of_run in facts if its != of_run), "")


def _check_age(model: KeptBatch, database: str) -> None:
    """Refuse a model whose batch has drifted by more than its sensors differ, with the sensors tested since."""
    if not model.level_drift:
        return
    with open_existing(database) or nullcontext() as store:
        lines = () if store is None else store.fleet.read_lines(RunSelection(batch=model.batch))
    known = {sensor.serial for sensor in model.sensors}
    later = {line.serial for line in lines if line.run > _last_run(model)} - known
    scatter = sum(member.weight * member.level**2 for member in model.members) ** 0.5
    if abs(model.level_drift) * len(later) > _MOST_DRIFT * scatter:
        raise RefusedError(
            f"the level of batch {model.batch!r} changes by {model.level_drift:+.1%} from one sensor to the next, and"
            f" {len(later)} sensors were tested since its model: more than its sensors differ ({scatter:.1%})",
            remedy=f"learn it again from the latest runs: cbsr-qa batch model --batch {model.batch}",
        )


def _last_run(model: KeptBatch) -> str:
    return max(sensor.run for sensor in model.sensors)
