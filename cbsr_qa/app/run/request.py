"""Requests to run a sensor, and their checks before a bench is opened."""

import hashlib
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import NamedTuple, Self

from cbsr_qa.app.gate.request import GateRequest, Override
from cbsr_qa.app.run.preflight import check_configuration
from cbsr_qa.config.merging import Configuration, list_files
from cbsr_qa.config.paths import calibrations_folder, check_folder, database_url, reports_folder
from cbsr_qa.config.serials import validate_batch, validate_operator, validate_reason, validate_serial
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.station.setup import configure
from cbsr_qa.store.engine import parse_url, sqlite_file
from cbsr_qa.store.opening import check_usable, open_existing

#: Seeds are limited to integers that every tool can represent.
_SEED_BITS = 31


@dataclass(frozen=True, slots=True)
class RunRequest:
    """A run to make; see the options of ``cbsr-qa run``.

    Parameters
    ----------
    override : override of the gate's refusals.
    golden : whether it measures the golden sensor of a station check.
    parts : parts of the sensor, checked by :func:`~cbsr_qa.config.serials.read_parts`.
    batch_model : file of the batch's model, for recipes that take it as prior; None for the newest of the batch.
    """

    station: str
    recipe: str
    serial: str
    batch: str = ""
    operator: str = ""
    sensor_type: str | None = None
    material: str | None = None
    seed: int | None = None
    database: str | None = None
    why: str = ""
    override: Override = field(default_factory=Override)
    golden: bool = False
    batch_model: Path | None = None
    parts: tuple[SensorPart, ...] = ()

    def validate(self) -> Self:
        """Return itself. Raise ConfigError if serial, batch, operator, reason or override is not allowed."""
        validate_serial(self.serial)
        validate_batch(self.batch)
        validate_operator(self.operator)
        validate_reason(self.why)
        self.override.validate()
        return self

    def configuration(self, seed: int, plugins: Plugins | None = None) -> Configuration:
        """Load and merge the files. RefusedError if one is missing or wrong, also the batch's model."""
        configuration = configure(
            self.station,
            self.recipe,
            sensor_type=self.sensor_type,
            material=self.material,
            seed=seed,
            plugins=plugins,
        )
        takes_batch = configuration.recipe.analysis.prior == "batch"
        if not takes_batch and self.batch_model is None:
            return configuration
        if not takes_batch:
            raise ConfigError(
                f"recipe {configuration.recipe.name!r} takes no batch as prior, and --batch-model is given",
                remedy='leave it out, or set prior = "batch" under [analysis] of the recipe',
            )
        from cbsr_qa.app.run.batch_model import add_prior  # loads what few recipes need

        return add_prior(configuration, self.batch, self.batch_model, database_url(self.database))


class CheckedRequest(NamedTuple):
    """A request that is in order: its files, those of seed 0, and what the gate is asked."""

    plugins: Plugins
    configuration: Configuration
    gate_request: GateRequest


def check_request(request: RunRequest) -> CheckedRequest:
    """Check names, files and plugins, then folders and database; nothing is opened or written.

    Raises
    ------
    RefusedError
        If one of them is wrong.
    """
    request.validate()
    plugins = discover()
    configuration = request.configuration(0, plugins)
    check_configuration(configuration, plugins)
    url, folders = database_url(request.database), (reports_folder(), calibrations_folder())
    file = sqlite_file(parse_url(url))
    for folder in (*folders, *(() if file is None else (file.parent,))):
        check_folder(folder)
    check_usable(url)
    return CheckedRequest(
        plugins, configuration, fill_from_object(GateRequest, request, database=url, folders=folders)
    )


def check_unchanged(configuration: Configuration, gated: Configuration) -> None:
    """Raise ConfigError if the files of a run are no longer those that its gate was asked about."""
    if list_files(configuration) != list_files(gated):
        raise ConfigError(
            "the files of this run were changed while the gate was asked",
            remedy="start the run again: the gate answers for the files as they are then",
        )


def default_seed(serial: str, earlier_runs: int) -> int:
    """Return the default seed, which depends on sensor and number of the try."""
    digest = hashlib.sha256(f"{serial}/{earlier_runs}".encode()).digest()
    return int.from_bytes(digest[:4]) >> (32 - _SEED_BITS)


def free_seeds(serial: str, database: str) -> Iterator[int]:
    """Yield default seeds of a sensor: each the next that no run has by then; creates no database."""
    yielded: set[int] = set()
    while True:
        with open_existing(database) or nullcontext() as store:
            stored = () if store is None else store.sensors.list_seeds(serial)
        seeds = (default_seed(serial, number) for number in count(len(stored)))
        seed = next(seed for seed in seeds if seed not in stored and seed not in yielded)
        yielded.add(seed)
        yield seed
