"""Configuration files, checked and turned into domain objects: the front door of this package.

Mesh files that a sensor type refers to are included by content, so that a stored run needs no file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from cbsr_qa.config.documents import Document, DocumentKind, open_document
from cbsr_qa.config.gate import empty_operators
from cbsr_qa.config.limits import with_limits
from cbsr_qa.config.material import MaterialFile
from cbsr_qa.config.recipe import RecipeFile, with_picture
from cbsr_qa.config.scene import STATION_TABLES, SceneFile
from cbsr_qa.config.sensor_type import ScannedTypeFile, SensorTypeFile
from cbsr_qa.config.standards import StandardsFile
from cbsr_qa.config.station import CertificateFile, StationFile, UnfinishedStationFile, resolve_options
from cbsr_qa.config.tables import FileModel, validate
from cbsr_qa.config.text import line_of
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.plan.plan import CertificateSettings, Recipe, Scene, Station
from cbsr_qa.domain.plan.scene_plan import ScenePlan
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.sensor.electrodes import widest_ring_mm
from cbsr_qa.domain.sensor.mesh import mesh_arrays
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.plugin.discovery import Plugins


def with_mesh(document: Document) -> Document:
    """Put the content of ``sensor_type.mesh`` in place of its name, which is looked for next to the file.

    Raises
    ------
    ConfigError
        If it cannot be read, or is not a valid mesh of a sheet.
    """
    sheet = document.data.get("sensor_type")
    name = sheet.get("mesh") if isinstance(sheet, Mapping) else None
    if not isinstance(name, str):
        return document
    from cbsr_qa.eit.mesh.files import read_mesh  # imports all of scipy

    try:
        mesh = read_mesh((document.folder or Path()) / name)
    except (NumericsError, ValueError) as error:  # a name with a NUL in it
        reason, remedy = (error.reason, error.remedy) if isinstance(error, NumericsError) else (str(error), "")
        line = line_of(document.text, ("sensor_type", "mesh"))
        place = f"line {line}: " if line else ""
        raise ConfigError(f"{document.label}: {place}sensor_type.mesh: {reason}", remedy=remedy) from error
    arrays = {key: array.tolist() for key, array in mesh_arrays(mesh).items()}
    assert isinstance(sheet, Mapping)
    return replace(document, data={**document.data, "sensor_type": {**sheet, "mesh": arrays}})


T = TypeVar("T")

#: Radius of a sheet whose size is to be found [mm].
UNIT_MM: Final = 100.0

#: A path, the name of a shipped file, or the parsed content itself (restored from a stored run).
Source = str | Path | Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Loaded(Generic[T]):
    """A domain object with the document it came from.

    Parameters
    ----------
    value : domain object, e.g. a :class:`~cbsr_qa.domain.plan.plan.Station`.
    document : source: text, path (None where shipped or restored), parsed data, and a label for messages.
    """

    value: T
    document: Document

    @property
    def folder(self) -> Path | None:
        """Folder that is searched first for references; pass it on as ``near``."""
        return self.document.folder


def load_station(source: Source, plugins: Plugins | None = None, *, unfinished: bool = False) -> Loaded[Station]:
    """Load a station. References of its instruments to files next to it become full paths.

    The document has nobody on the list of operators, see :mod:`cbsr_qa.config.gate`.

    Parameters
    ----------
    plugins : installed plugins, to check their options as well; None checks none. The same for every loader here.
    unfinished : whether instruments that every run needs may be missing.

    Raises
    ------
    ConfigError
        As for every loader here: the file does not exist or is not TOML, or a list of its problems.
    """
    model = UnfinishedStationFile if unfinished else StationFile
    loaded = _load(DocumentKind.STATION, model, source, None, plugins)
    instruments = tuple(resolve_options(i, loaded.folder) for i in loaded.value.instruments)
    document = replace(loaded.document, data=empty_operators(loaded.document.data))
    return Loaded(replace(loaded.value, instruments=instruments), document)


def load_recipe(source: Source, plugins: Plugins | None = None) -> Loaded[Recipe]:
    """Load a recipe; pictures of prompts get their full path. See :func:`load_station` for what is raised.

    A recipe from a database has no folder: its pictures keep their names.
    """
    loaded = _load(DocumentKind.RECIPE, RecipeFile, source, None, plugins)
    phases = tuple(with_picture(phase, loaded.folder) for phase in loaded.value.phases)
    return Loaded(replace(loaded.value, phases=phases), loaded.document)


def load_sensor_type(source: Source, *, near: Path | None = None) -> Loaded[SensorType]:
    """Load a sensor type, looked for in the folder ``near`` first. See :func:`load_station` for what is raised."""
    return _load(DocumentKind.SENSOR_TYPE, SensorTypeFile, source, near)


def load_scanned_type(source: Source) -> Loaded[SensorType]:
    """Load a sensor type for readings that bring their pattern; that of the file does not matter.

    See :func:`load_station` for what is raised.
    """
    return _load(DocumentKind.SENSOR_TYPE, ScannedTypeFile, source, None)


def load_pressed_type(source: Source, *, scanned: bool = False) -> tuple[Loaded[SensorType], bool]:
    """Load the sensor type of a sheet that is calibrated by presses, which may leave its size out.

    A disc without ``radius_mm`` gets a radius of :data:`UNIT_MM` and electrodes at its rim; ``thickness_mm``,
    ``ring_radius_mm`` and the electrodes' size do not matter then.

    Parameters
    ----------
    scanned : whether the readings bring their pattern, as for :func:`load_scanned_type`.

    Returns
    -------
    The sensor type, and whether its size is stated. See :func:`load_station` for what is raised.
    """
    document = open_document(DocumentKind.SENSOR_TYPE, source) if not isinstance(source, Mapping) else None
    sheet = None if document is None else document.data.get("sensor_type")
    if document is None or not isinstance(sheet, Mapping) or sheet.keys() & {"radius_mm", "outline_mm", "mesh"}:
        return load_scanned_type(source) if scanned else load_sensor_type(source), True
    data = {**document.data, "sensor_type": {"thickness_mm": 1.0, **sheet, "radius_mm": UNIT_MM}}
    electrodes = data.get("electrodes")
    if isinstance(electrodes, Mapping):
        data["electrodes"] = _place_at_rim(electrodes)
    unsized = replace(document, data=data)
    return Loaded(validate(ScannedTypeFile if scanned else SensorTypeFile, unsized, None), unsized), False


def _place_at_rim(electrodes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the electrodes of a sheet of unknown size: small ones at its rim."""
    count = electrodes.get("count")
    width_mm = UNIT_MM * min(0.03, 1 / count) if isinstance(count, int) and count > 0 else 0.03 * UNIT_MM
    is_arc = electrodes.get("kind") == "arc"
    kept_keys = {key: value for key, value in electrodes.items() if key not in ("diameter_mm", "length_mm")}
    ring_mm = UNIT_MM if is_arc else widest_ring_mm(width_mm, UNIT_MM)
    return {**kept_keys, "ring_radius_mm": ring_mm, "length_mm" if is_arc else "diameter_mm": width_mm}


def load_standards(source: Source) -> Loaded[tuple[ReferenceStandard, ...]]:
    """Load reference standards from a file of their own, or of a station. See :func:`load_station` for errors."""
    return _load(DocumentKind.STANDARDS, StandardsFile, source, None)


def load_certificate_settings(source: Source) -> Loaded[CertificateSettings]:
    """Load what certificates state, from a file of its own or of a station. See :func:`load_station` for errors."""
    return _load(DocumentKind.CERTIFICATE, CertificateFile, source, None)


def load_material(source: Source, *, near: Path | None = None) -> Loaded[Material]:
    """Load a material, looked for in the folder ``near`` first. See :func:`load_station` for what is raised."""
    return _load(DocumentKind.MATERIAL, MaterialFile, source, near)


def load_scene(source: Source, plugins: Plugins | None = None, *, near: Path | None = None) -> Loaded[Scene]:
    """Load the tables of a scene that a station needs; the folder ``near`` is searched first.

    The document is reduced to the same tables: the others are not part of a run's configuration. See
    :func:`load_station` for what is raised.
    """
    plan = load_scene_plan(source, plugins, near=near)
    station_tables = {key: value for key, value in plan.document.data.items() if key in STATION_TABLES}
    return Loaded(plan.value.scene, replace(plan.document, data=station_tables))


def load_scene_plan(source: Source, plugins: Plugins | None = None, *, near: Path | None = None) -> Loaded[ScenePlan]:
    """Load all of a scene, its recording and its loads too. See :func:`load_station` for what is raised."""
    return _load(DocumentKind.SCENE, SceneFile, source, near, plugins)


def _load(
    kind: DocumentKind,
    model: type[FileModel[T]],
    source: Source,
    near: Path | None,
    plugins: Plugins | None = None,
) -> Loaded[T]:
    if isinstance(source, Mapping):
        document = Document(kind, f"stored {kind.noun}", None, "", source)
    else:
        document = open_document(kind, source, near=near)
        if kind is DocumentKind.SENSOR_TYPE:
            document = with_mesh(document)
        elif kind is DocumentKind.RECIPE:
            document = with_limits(document)
    return Loaded(validate(model, document, plugins), document)
