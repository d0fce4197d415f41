"""Simulated sensors of one batch that respond alike, tested and stored: ``make fleet-demo`` learns the batch."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from cbsr_qa.app.run.console import NOBODY
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.paths import var_folder
from cbsr_qa.config.text import toml_document
from cbsr_qa.studies.frontier.setting import CHECK, GRID, Setting
from cbsr_qa.studies.simulated import copy_shipped

BATCH: Final = "41"
SENSORS: Final = 5
#: Share of the variance of maps that two of the sensors have in common.
RHO: Final = 0.9
_EFFECTS: Final = (
    {"name": "batch-pattern", "rho": RHO, "batch": BATCH, "deviation": 0.2, "correlation_mm": 20.0},
    {"name": "residue", "share": 0.03, "decay_s": 300.0},
)


def demo_folder() -> Path:
    """Folder of the station, the recipe and the database of these sensors."""
    return var_folder() / "fleet-demo-batch"


def build_batch(count: Callable[[int, int], None] = lambda done, of: None) -> Path:
    """Test the sensors at a simulated station, and return their database; an earlier one is replaced.

    The station's file stays beside it, for runs of further sensors.
    """
    folder = demo_folder()
    folder.mkdir(parents=True, exist_ok=True)
    documents = {"station": _describe_station(), "scene": _describe_scene(), "recipe": _describe_recipe()}
    for name, document in documents.items():
        (folder / f"{name}.toml").write_text(toml_document(document), encoding="utf-8")
    database = folder / "runs.db"
    for suffix in ("", "-wal", "-shm"):
        database.with_name(database.name + suffix).unlink(missing_ok=True)
    for number in range(SENSORS):
        request = RunRequest(
            station=str(folder / "station.toml"),
            recipe=str(folder / "recipe.toml"),
            serial=f"B{BATCH}-{number + 1:02d}",
            batch=BATCH,
            database=str(database),
        )
        run_sensor(request, NOBODY)
        count(number + 1, SENSORS)
    return database


def _describe_station() -> dict[str, Any]:
    station = copy_shipped(DocumentKind.STATION, "simulated")
    station["instruments"]["bench"]["scene"] = "scene.toml"
    return station


def _describe_scene() -> dict[str, Any]:
    scene = copy_shipped(DocumentKind.SCENE, "base")
    scene["effects"] = [*scene["effects"], *(dict(effect) for effect in _EFFECTS)]
    return scene


def _describe_recipe() -> dict[str, Any]:
    """Sixteen places held briefly, five random loads of a minute; measured is only what a batch is learned from."""
    recipe = Setting(16, hold_s=15.0, rest_s=15.0, predicted=True, checks=5).recipe("sixteen-places")
    recipe["phases"] = [phase for phase in recipe["phases"] if phase["name"] in (GRID, CHECK)]
    recipe["phases"][0]["initial_rest_s"] = 240.0
    recipe["analysis"]["learn_place"] = False
    recipe["metrics"] = {"image-noise": {}, "channel-noise": {}}
    recipe["limits"] = [limit for limit in recipe["limits"] if limit["measurement"] in ("noise_floor", "channel_snr")]
    recipe["report"] = {"sections": ["limits"]}
    return recipe
