"""Where a new run's files differ from those of the latest run with the same names."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

from sqlalchemy import ColumnElement, Connection, select

from cbsr_qa.domain.run.changes import (
    NO_REASON,
    FileKind,
    differences,
)
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.store.chain.links import add_rows
from cbsr_qa.store.tables.records import ConfigurationChangeRow
from cbsr_qa.store.tables.runs import RunRow


def note_changes(connection: Connection, identity: RunIdentity, configuration: str, material: str, why: str) -> None:
    """Note where a new run's files differ from those of the latest run with the same names.

    Parameters
    ----------
    configuration : canonical JSON of the run.
    material : its name.
    why : in the operator's words; may be empty.
    """
    now = json.loads(configuration)
    rows = []
    for kind, name, names in list_files(identity, material):
        new = _content(now, kind)
        earlier = select(RunRow.run, RunRow.configuration).where(names, RunRow.run < identity.run)
        earlier_row = connection.execute(earlier.order_by(RunRow.run.desc()).limit(1)).one_or_none()
        if earlier_row is None:
            continue
        old = _content(json.loads(earlier_row.configuration), kind)
        changed = differences(old, new)
        if changed:
            rows.append(
                {
                    "run": identity.run,
                    "kind": str(kind),
                    "name": name,
                    "earlier_run": earlier_row.run,
                    "old_sha256": _digest(old),
                    "new_sha256": _digest(new),
                    "differences": [[change.key, change.before, change.after] for change in changed],
                    "operator": identity.operator,
                    "noted_at": identity.started_at,
                    "why": why or NO_REASON,
                }
            )
    add_rows(connection, identity.run, ConfigurationChangeRow, rows)


def list_files(identity: RunIdentity, material: str) -> Iterator[tuple[FileKind, str, ColumnElement[bool]]]:
    """Yield kind and name of a run's files, and the condition for other runs that use a file of that name."""
    yield FileKind.RECIPE, identity.recipe, RunRow.recipe == identity.recipe
    yield FileKind.STATION, identity.station, RunRow.station == identity.station
    sensor_type = identity.sensor.sensor_type
    yield FileKind.SENSOR_TYPE, sensor_type, RunRow.sensor_type == sensor_type
    yield FileKind.MATERIAL, material, RunRow.setting["material"]["name"].as_string() == material


def _content(configuration: Mapping[str, Any], kind: FileKind) -> dict[str, Any]:
    """Return a run's configuration of one file; for a station, with its scenes."""
    content = dict(configuration.get(kind.value.replace(" ", "_"), {}))
    if kind is FileKind.STATION:
        content |= {key: configuration[key] for key in ("scenes", "emulated_scene") if configuration.get(key)}
    return content


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()
