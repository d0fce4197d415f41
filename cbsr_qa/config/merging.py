"""The whole configuration of a run as one document, which is stored, digested, and restored on resume."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from datetime import date, datetime, time
from pathlib import Path
from typing import Any, Self

from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import Loaded, load_material, load_recipe, load_scene, load_sensor_type, load_station
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.filling import fill_from_mapping, find_odd_value
from cbsr_qa.domain.plan.batch_model import KeptBatch
from cbsr_qa.domain.plan.plan import Recipe, Scene, Station
from cbsr_qa.domain.plan.standards import StandardRole, find_standard
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.system.json_text import parse_json

_OF_A_RUN = (DocumentKind.STATION, DocumentKind.RECIPE, DocumentKind.SENSOR_TYPE, DocumentKind.MATERIAL)

#: Version of the document's layout, and of that of a batch's model in it (before 2 its rough maps were smoother).
LAYOUT = 1
BATCH_LAYOUT = 2
#: Size above that of any model's file [bytes].
_MOST_BYTES = 2**26
_BATCH = "batch_model"
#: What a batch's model is called among the files of a run.
BATCH_NOUN = "batch model"
#: Parts of the document that determine how a run is analysed.
RECIPE_KEYS = ("recipe", _BATCH)


@dataclass(frozen=True, slots=True, eq=False)
class Configuration:
    """Everything a run is configured with.

    Parameters
    ----------
    station, recipe, sensor_type, material : content of the files, checked and in domain terms.
    seed : seed of the run.
    canonical : all files' content as canonical JSON (keys sorted, no blanks); paths of files are not in it,
        so the same content gives the same digest wherever it lies.
    serial_pattern : regular expression that serial numbers of the sensor type match; empty for any.
    unique_parts : names of the parts of which each is of one sensor only.
    """

    station: Station
    recipe: Recipe
    sensor_type: SensorType
    material: Material
    seed: int
    canonical: str
    serial_pattern: str = ""
    unique_parts: tuple[str, ...] = ()

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON, hexadecimal."""
        return hashlib.sha256(self.canonical.encode()).hexdigest()


def merge(
    station: Loaded[Station],
    recipe: Loaded[Recipe],
    sensor_type: Loaded[SensorType],
    material: Loaded[Material],
    *,
    seed: int,
    plugins: Plugins | None = None,
) -> Configuration:
    """Merge the files of a run; scenes of its instruments are included by content.

    Parameters
    ----------
    plugins : installed plugins, to check the effects of scenes as well; None checks none.

    Raises
    ------
    ConfigError
        If a scene an instrument refers to is missing or wrong, or its current is outside the range of the station's
        certificate of the source meter.
    """
    scenes = {
        instrument.role: load_scene(name, plugins, near=station.folder)
        for instrument in station.value.instruments
        if (name := instrument.options.get("scene")) is not None
    }
    _check_currents(station.value, scenes)
    emulated = station.value.emulated_scene
    world = None if emulated is None else load_scene(emulated, plugins, near=station.folder)
    content = {
        "layout": LAYOUT,
        "seed": seed,
        "station": station.document.data,
        "recipe": recipe.document.data,
        "sensor_type": sensor_type.document.data,
        "material": material.document.data,
        "scenes": {role: scene.document.data for role, scene in scenes.items()},
        **({} if world is None else {"emulated_scene": world.document.data}),
    }
    return Configuration(
        _with_scenes(station.value, scenes, world),
        recipe.value,
        sensor_type.value,
        material.value,
        seed,
        canonical_json(content),
        *_sensor_rules(sensor_type.document.data),
    )


def _check_currents(station: Station, scenes: Mapping[str, Loaded[Scene]]) -> None:
    meter = find_standard(station.standards, StandardRole.SOURCE_METER)
    for role, scene in scenes.items():
        current_mA = 1e3 * scene.value.current_A
        if meter is not None and not meter.covers(round(current_mA, 9)):
            raise ConfigError(
                f"standards.source_meter.range_mA of station {station.name} is {meter.range_words()}, and the scene"
                f" of instruments.{role} drives {current_mA:g} mA",
                remedy="state the certificate that covers it, or drive a current that it covers",
            )


def restore(canonical: str) -> Configuration:
    """Return the stored configuration of a run, checked again by today's rules.

    Raises
    ------
    ConfigError
        If its layout is unknown to this version, or it no longer passes the checks.
    """
    content = json.loads(canonical)
    if not isinstance(content, Mapping) or content.get("layout") != LAYOUT:
        raise ConfigError(
            "the stored configuration is of a layout this version does not know",
            remedy="resume the run with the version that began it",
        )
    missing = [
        key for key in ("station", "recipe", "sensor_type", "material", "scenes", "seed") if key not in content
    ]
    if missing:
        raise ConfigError(
            f"the stored configuration has no {missing[0]!r}", remedy="resume the run with the version that began it"
        )
    station = load_station(content["station"])
    scenes = {role: load_scene(data) for role, data in content["scenes"].items()}
    world = load_scene(content["emulated_scene"]) if "emulated_scene" in content else None
    return Configuration(
        _with_scenes(station.value, scenes, world),
        restore_recipe(content),
        load_sensor_type(content["sensor_type"]).value,
        load_material(content["material"]).value,
        int(content["seed"]),
        canonical,
        *_sensor_rules(content["sensor_type"]),
    )


def restore_recipe(content: Mapping[str, Any]) -> Recipe:
    """Return the recipe of a stored configuration, with the batch's model if it has one."""
    return _with_batch(load_recipe(content["recipe"]).value, content.get(_BATCH))


def add_batch_model(configuration: Configuration, kept: KeptBatch) -> Configuration:
    """Return the configuration of a run that takes this batch as the prior of its sensor's map."""
    model = asdict(kept)
    content = json.loads(configuration.canonical) | {_BATCH: model}
    return replace(configuration, recipe=_with_batch(configuration.recipe, model), canonical=canonical_json(content))


def digest_batch_model(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the content of a batch's model, but for what is stated of it in the content itself."""
    rest = {key: value for key, value in content.items() if key != "content_sha256"}
    return content_digest(rest)


def read_batch_model(content: Mapping[str, Any], where: str) -> KeptBatch:
    """Return a batch's model as it was kept.

    Parameters
    ----------
    where : what the content was read from, for messages.

    Raises
    ------
    ConfigError
        If it is not such a model, of another layout, or was changed.
    """
    write_again = "learn it again: cbsr-qa batch model"
    if content.get("layout") != BATCH_LAYOUT:
        raise ConfigError(
            f"{where} is a batch's model of layout {content.get('layout')!r}; this version reads {BATCH_LAYOUT}",
            remedy=write_again,
        )
    try:
        kept = fill_from_mapping(KeptBatch, content)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ConfigError(f"{where} is not a batch's model", remedy=write_again) from error
    if odd := find_odd_value(KeptBatch, kept):
        raise ConfigError(f"{where} is not a batch's model: {odd}", remedy=write_again)
    if digest_batch_model(content) != kept.content_sha256:
        raise ConfigError(f"{where} was changed: its content is not that of its SHA-256", remedy=write_again)
    return kept


def read_model_file(path: Path) -> KeptBatch:
    """Read a model's file. ConfigError if it cannot be read, is of another layout, or was changed."""
    try:
        content = parse_json(read_foreign(path, _MOST_BYTES))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is not the file of a batch's model"
        raise ConfigError(
            f"{path} cannot be read: {why}", remedy="cbsr-qa batch model --to FILE writes one"
        ) from error
    return read_batch_model(content if isinstance(content, dict) else {}, str(path))


def _with_batch(recipe: Recipe, model: Mapping[str, Any] | None) -> Recipe:
    if model is None:
        return recipe
    kept = read_batch_model(model, "the batch's model in the configuration")
    return replace(recipe, analysis=replace(recipe.analysis, batch=kept))


@dataclass(frozen=True, slots=True)
class FileContent:
    """One file of a configuration: its kind, the name it states, and the SHA-256 of its content."""

    kind: str
    name: str
    sha256: str

    @classmethod
    def from_table(cls, kind: DocumentKind, data: Mapping[str, Any]) -> Self:
        return cls(kind.noun, str(data[kind.table]["name"]), content_digest(data))

    @classmethod
    def from_batch(cls, kept: KeptBatch) -> Self:
        """A batch's model, by the name of the batch."""
        return cls(BATCH_NOUN, kept.batch, kept.content_sha256)


def content_digest(data: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a file's content, which comments and the order of keys do not change."""
    return hashlib.sha256(canonical_json(data).encode()).hexdigest()


def list_files(configuration: Configuration) -> tuple[FileContent, ...]:
    """Return the files that a run is configured by.

    They are station, recipe, sensor type, material, scenes once each, and the batch's model if it has one.
    """
    content = json.loads(configuration.canonical)
    data_by_kind = {kind: content[kind.table] for kind in _OF_A_RUN}
    scenes = [*content["scenes"].values(), *([content["emulated_scene"]] if "emulated_scene" in content else [])]
    contents = [FileContent.from_table(kind, data) for kind, data in data_by_kind.items()]
    contents += [FileContent.from_table(DocumentKind.SCENE, data) for data in scenes]
    batch = configuration.recipe.analysis.batch
    contents += [] if batch is None else [FileContent.from_batch(batch)]
    return tuple(dict.fromkeys(contents))


def canonical_json(content: Any) -> str:
    """Write canonical JSON: keys sorted, no blanks, dates in ISO form, UTF-8.

    Raises
    ------
    ValueError
        If a number is not finite.
    """
    return json.dumps(
        content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, default=_serialise
    )


def _sensor_rules(sensor_type: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    """Return the pattern of serial numbers, and the parts that are unique."""
    table = sensor_type["sensor_type"]
    return str(table.get("serial_pattern", "")), tuple(table.get("unique_parts", ()))


def _serialise(value: object) -> object:
    if isinstance(value, date | datetime | time):
        return value.isoformat()
    raise TypeError(f"a configuration holds no {type(value).__name__}")


def _with_scenes(station: Station, scenes: Mapping[str, Loaded[Scene]], world: Loaded[Scene] | None) -> Station:
    """Pass drivers the content of their scene, so that a stored run needs no files."""
    instruments = tuple(
        replace(i, options={**i.options, "scene": scenes[i.role].document.data}) if i.role in scenes else i
        for i in station.instruments
    )
    emulated = station.emulated_scene if world is None else world.document.data
    return replace(station, instruments=instruments, emulated_scene=emulated)
