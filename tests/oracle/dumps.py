"""Files that are not text, as text: databases, HDF5 files, pages."""

import hashlib
import re
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import h5py
import numpy as np

from tests.oracle.masks import UUID, masked

#: Columns of digests that hold neither identities nor times.
_OF_CONTENT = {"configuration_digest", "reference_sha256", "force_sha256", "old_sha256", "new_sha256"}


def dumped(path: Path) -> str | None:
    """Return a file as lines to compare; None where it is not compared (logs of the database, caches)."""
    if path.suffix == ".db":
        return _database(path)
    if path.suffix == ".h5":
        return _hdf5(path)
    if path.suffix == ".html":
        return re.sub(r"(?<!\n)(<[^/])", r"\n\1", path.read_text())
    if path.suffix in {".json", ".toml", ".csv", ".txt", ".svg", ".md"}:
        return path.read_text()
    if path.suffix == ".png":
        return "a picture\n"
    return None


def _database(path: Path) -> str:
    lines = []
    with closing(sqlite3.connect(path)) as database:
        schema = database.execute(
            "select type, name, sql from sqlite_master where sql is not null order by type, name"
        )
        lines += [f"{kind} {name}: {' '.join(sql.split())}" for kind, name, sql in schema]
        tables = [
            name for (name,) in database.execute("select name from sqlite_master where type = 'table' order by name")
        ]
        for table in tables:
            found = database.execute(f'select * from "{table}"')
            names = [column[0] for column in found.description]
            rows = [[_cell(name, cell) for name, cell in zip(names, row, strict=True)] for row in found]
            lines += [f"# {table}: {', '.join(names)}", *ordered(f"{table} {' | '.join(row)}" for row in rows)]
    return "\n".join(lines) + "\n"


def ordered(rows: Iterable[str]) -> list[str]:
    """Sort rows by what is left of them once masked: identities and times would put them in an order of their own."""
    return sorted(rows, key=lambda row: masked(UUID.sub("<id>", row), {}))


def _cell(name: str, cell: object) -> str:
    if name == "compute_s":  # how long this computer took
        return "<s>"
    if name == "file" and isinstance(cell, bytes):  # of a calibration: names identities, compared as written
        return "<file>"
    if isinstance(cell, bytes) and len(cell) == 32:  # of links and seals: they cover identities and times
        return "<digest>"
    if isinstance(cell, bytes):
        return f"blob {hashlib.sha1(cell).hexdigest()}"
    # Digests that cover neither identities nor times are compared: shortened, they escape the mask.
    return f"'sha256 {cell[:40]}'" if name in _OF_CONTENT and isinstance(cell, str) else repr(cell)


def _hdf5(path: Path) -> str:
    lines: list[str] = []

    def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
        lines.append(f"{name} {_attributes(item)}")
        if isinstance(item, h5py.Dataset):
            value = np.asarray(item[()])
            content = str(value.tolist()).encode() if value.dtype == object else value.tobytes()
            text = str(value.tolist()) if value.size <= 16 else hashlib.sha1(content).hexdigest()
            lines.append(f"{name} {value.dtype} {value.shape} {text}")

    with h5py.File(path) as file:
        lines.append(_attributes(file))
        file.visititems(visit)
    return "\n".join(lines) + "\n"


def _attributes(item: h5py.Group | h5py.Dataset) -> str:
    return "; ".join(f"{key}={np.asarray(item.attrs[key]).tolist()}" for key in sorted(item.attrs))
