"""Release configuration files for runs, or withdraw a release."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cbsr_qa.config.documents import DocumentKind, list_shipped, open_document
from cbsr_qa.config.loader import Loaded, load_material, load_recipe, load_scene, load_sensor_type, load_station
from cbsr_qa.config.merging import FileContent, read_model_file
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.gate import Release
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.report.page import answer
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.clock import RealClock
from cbsr_qa.system.words import echo

_Load = Callable[[str, Plugins], Loaded[Any]]
_LOADERS: Final[Mapping[DocumentKind, _Load]] = {
    DocumentKind.STATION: load_station,
    DocumentKind.RECIPE: load_recipe,
    DocumentKind.SENSOR_TYPE: lambda file, plugins: load_sensor_type(file),
    DocumentKind.MATERIAL: lambda file, plugins: load_material(file),
    DocumentKind.SCENE: load_scene,
}


@dataclass(frozen=True, slots=True)
class ReleaseRequest:
    """A file to release, or whose release to withdraw; see the options of ``cbsr-qa release``."""

    file: str
    by: str
    why: str
    withdraw: bool = False
    database: str | None = None


@dataclass(frozen=True, slots=True)
class Released(Release):
    """The stored release or withdrawal, and the one of this content before it."""

    before: Release | None


def release_file(request: ReleaseRequest) -> CommandOutcome[Released]:
    """Store that a file of just this content may configure runs, or no longer.

    Raises
    ------
    ConfigError
        If the file does not exist, is not a file of a run or has mistakes, or if name or reason is missing.
    StoreError
        If the database cannot be used.
    """
    for option, text, missing_fact in (
        ("--by", request.by, "who decides"),
        ("--why", request.why, "for what reason"),
    ):
        if not text.strip():
            raise ConfigError(f"a release needs {option}", remedy=f"say {missing_fact}")
    operator, reason = validate_operator(request.by), validate_reason(request.why)
    content = _read_content(request.file)
    with open_store(database_url(request.database)) as store:
        earlier_release = store.releases.read_latest(content.kind, content.sha256)
        if request.withdraw and (earlier_release is None or earlier_release.action != "released"):
            raise ConfigError(f"{content.kind} {content.name!r} is not released with this content")
        released = Released(
            release=store.new_id(),
            kind=content.kind,
            name=content.name,
            sha256=content.sha256,
            action="withdrawn" if request.withdraw else "released",
            by=operator,
            why=reason,
            at=RealClock().wall(),
            before=earlier_release,
        )
        store.releases.save(released)
    facts = (("Content", f"SHA-256 {released.sha256}"), ("Why", released.why))
    return answer(released, f"{released.kind} {released.name} {released.action} by {released.by}", "", facts)


def _read_content(file: str) -> FileContent:
    """Read what a file of a run or of a batch's model is. ConfigError if it is neither, or has mistakes."""
    if file.endswith(".json"):
        return FileContent.from_batch(read_model_file(Path(file)))
    kind = _kind(file)
    return FileContent.from_table(kind, _LOADERS[kind](file, discover()).document.data)


def _kind(file: str) -> DocumentKind:
    """Return what a file is by its table, and a shipped one by its name. Raise ConfigError if it is neither."""
    if file.endswith(".toml") or "/" in file or "\\" in file:
        kinds = []
        for kind in _LOADERS:
            with suppress(ConfigError):
                if kind.table in open_document(kind, file).data:
                    kinds.append(kind)
    else:
        kinds = [kind for kind in _LOADERS if file in list_shipped(kind)]
    if len(kinds) == 1:
        return kinds[0]
    known_kinds = ", ".join(kind.noun for kind in _LOADERS)
    if not kinds:
        open_document(DocumentKind.STATION, file)  # says what is wrong with a file that cannot be read
        raise ConfigError(
            f"{echo(file)} is no file of a run",
            remedy=f"give the path or the shipped name of a {known_kinds}, or a batch's model (.json)",
        )
    raise ConfigError(
        f"{echo(file)} is the name of a {' and a '.join(kind.noun for kind in kinds)}", remedy="give the path"
    )
