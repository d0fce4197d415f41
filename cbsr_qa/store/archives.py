"""Files that hold the frames of archived runs: one HDF5 file a run, found from the database and checked when read.

The rows of its blocks stay in the database, with shape, times and digest, which the chain covers. Only their arrays
are in the file.
"""

import hashlib
import io
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import h5py
import numpy as np
from sqlalchemy import Connection, Engine, Row, select

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.engine import sqlite_file
from cbsr_qa.store.tables.records import ArchiveRow
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import open_foreign, read_foreign
from cbsr_qa.system.untrusted import read_untrusted

#: Arrays of a block; empty in the row of an archived one.
ARRAYS: Final = ("time_s", "voltages", "flags", "reading_time_s")
#: Environment variable that names the folder of a server's archives, as this computer reaches it.
ROOT_VARIABLE: Final = "CBSR_QA_ARCHIVE"
_NAME_ROOT: Final = f"set {ROOT_VARIABLE} to the folder of the archives, as this computer reaches it"
_UNITS: Final = {"time_s": "s", "flags": "1", "reading_time_s": "s"}
#: Largest archive that is read: a run of a day at 100 frames a second. All of it is in memory.
_MAX_ARCHIVE_BYTES: Final = 2**32
_FORMAT: Final = "cbsr-qa archive"
_KINDS: Final = {"flags": np.uint8}
#: Numbers of the HDF5 filters that are allowed: gzip, byte shuffle and checksum.
_FILTERS: Final = frozenset({1, 2, 3})


def archive_root(engine: Engine) -> Path | None:
    """Return the root folder of archives: that of the SQLite file, else that of CBSR_QA_ARCHIVE, else None."""
    database = sqlite_file(engine.url)
    return _environment_folder() if database is None else database.resolve().parent


def _environment_folder() -> Path | None:
    folder = os.environ.get(ROOT_VARIABLE)
    return Path(folder).resolve() if folder else None


def place_of(engine: Engine, file: Path) -> str:
    """Return how a database names a file: its path from the root of its archives.

    Raises
    ------
    StoreError
        If a server's archives have no root, or the file is in no folder of archives: it would not be read again.
    """
    root, absolute = archive_root(engine), file.resolve()
    if root is None:
        raise StoreError("a PostgreSQL database has no folder", remedy=_NAME_ROOT)
    _check_inside(root, absolute)
    return os.path.relpath(absolute, root)


def _check_inside(root: Path, file: Path) -> None:
    """Refuse a path, links followed, that leads out of the folders of archives: a database could name any file."""
    folders = [folder for folder in (root, _environment_folder()) if folder is not None]
    if not any(file.is_relative_to(folder) for folder in folders):
        allowed = " or ".join(map(str, dict.fromkeys(folders)))
        raise StoreError(
            f"{file} is not below {allowed}, the folder of archives: only files in it are read",
            remedy=f"choose a folder below it, or name another one with {ROOT_VARIABLE}",
        )


def file_at(engine: Engine, place: str) -> Path:
    """Return the file that a database names, links followed.

    StoreError if this computer does not name or reach the root, or the file is in no folder of archives.
    """
    root = archive_root(engine)
    if root is None:
        raise StoreError(f"{place} is in the folder of archives, which nothing names here", remedy=_NAME_ROOT)
    if not root.is_dir():
        raise StoreError(
            f"{place} is in the folder of archives, and {root} is not reached from this computer", remedy=_NAME_ROOT
        )
    try:
        file = (root / place).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # links in a circle, a NUL
        raise StoreError(f"{place!r} is not the path of an archive: {error}") from error
    _check_inside(root, file)
    return file


def archive_row(connection: Connection, run: str) -> Row[Any] | None:
    """Return where the frames of a run are archived; None if they are in the database."""
    return connection.execute(select(*ArchiveRow.__table__.columns).where(ArchiveRow.run == run)).one_or_none()


def read_checked(connection: Connection, run: str) -> bytes | None:
    """Return the archive of a run; None if its frames are in the database.

    Raises
    ------
    StoreError
        If the file is missing, cannot be read, or is not the one that was written.
    """
    row = archive_row(connection, run)
    if row is None:
        return None
    try:
        file = file_at(connection.engine, row.file)
    except StoreError as error:
        raise StoreError(f"run {run}: its frames are archived; {error.reason}", remedy=error.remedy) from error
    try:
        with open_foreign(file, _MAX_ARCHIVE_BYTES) as archive:
            size_bytes = os.fstat(archive.fileno()).st_size
            if size_bytes != row.file_bytes:  # before gigabytes are read
                reason = f"it has {size_bytes} bytes, {row.file_bytes} were written"
                raise _alteration_error(run, file, reason)
            data = archive.read(size_bytes)
    except OSError as error:
        raise StoreError(
            f"run {run}: its frames are archived in {file}, which cannot be read: {error.strerror}",
            remedy="put the file back there, from a copy if need be",
        ) from error
    if hashlib.sha256(data).hexdigest() != row.file_sha256:
        raise _alteration_error(run, file, "it does not match its digest")
    return data


def _alteration_error(run: str, file: Path, why: str) -> StoreError:
    return StoreError(
        f"run {run}: its frames are archived in {file}, which was changed: {why}",
        remedy="put the file back as it was, from a copy",
    )


def archive_bytes(file: Path, most_bytes: int) -> bytes:
    """Return the content of an archive. OSError if it is missing, not a file, or too large to be the one expected."""
    return read_foreign(file, min(most_bytes, _MAX_ARCHIVE_BYTES))


class Archives:
    """Archives of runs. The latest stays open, so that a run read in parts is read from its file once."""

    def __init__(self) -> None:
        self._run = ""
        self._archive: Archive | None = None

    def find(self, connection: Connection, run: str) -> "Archive | None":
        """Return the archive of a run; None if its frames are in the database. Raises like :func:`read_checked`."""
        if run != self._run:
            row, data = archive_row(connection, run), read_checked(connection, run)
            self._archive = (
                None if row is None or data is None else open_archive(data, file_at(connection.engine, row.file))
            )
            self._run = run
        return self._archive


def with_arrays(connection: Connection, rows: Sequence[Any], archives: Archives | None = None) -> Iterator[Any]:
    """Yield rows of frame blocks of one run with their arrays, from the run's archive where it has one.

    Parameters
    ----------
    archives : archives already open, if the run is read in parts; None opens the run's own.

    Raises
    ------
    StoreError
        If the archive is missing, was altered, or does not hold a block; see :func:`read_checked`.
    """
    archived_run = next((row.run for row in rows if not row.voltages), None)
    archive = None if archived_run is None else (archives or Archives()).find(connection, archived_run)
    for row in rows:  # without an archive, a row that lacks its arrays is refused by its digest
        yield row if row.voltages or archive is None else with_cells(row, archive.cells(row.phase, row.block))


def with_cells(row: Any, cells: dict[str, bytes | None]) -> Any:
    """Return a row with the arrays of its archive."""
    return SimpleNamespace(**(dict(row._mapping) | cells))


def write_archive(file: Path, run: str, blocks: Iterable[tuple[int, int, Any]]) -> None:
    """Write the frames of a run, and wait until they are on the disk.

    Parameters
    ----------
    blocks : phase, number and :class:`~cbsr_qa.domain.readings.frames.FrameBlock` of each block.

    Raises
    ------
    StoreError
        If the file cannot be written; none is left then.
    """
    groups: dict[str, list[tuple[int, Any]]] = {}
    for phase, number, block in blocks:
        timed = "" if block.reading_time_s is None else "-timed"
        name = f"phase-{phase}/{block.voltages.shape[1]}x{block.voltages.shape[2]}-{block.unit}{timed}"
        groups.setdefault(name, []).append((number, block))
    with h5py.File("archive.h5", "w", driver="core", backing_store=False) as content:
        content.attrs.update({"format": _FORMAT, "run": run})
        for name, numbered_blocks in groups.items():
            _write_group(content.create_group(name), numbered_blocks)
        content.flush()
        image = bytes(content.id.get_file_image())
    with writing(file, refusal=StoreError, remedy="choose another folder with --to, or free space"):
        file.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(file) as whole:
            whole.write(image)
        _sync_folder(file.parent)


def _write_group(group: h5py.Group, numbered_blocks: list[tuple[int, Any]]) -> None:
    counts = [len(block) for _, block in numbered_blocks]
    group.create_dataset("block", data=np.array([number for number, _ in numbered_blocks]))
    group.create_dataset("frames", data=np.array(counts))
    for name in ARRAYS:
        parts = [getattr(block, name) for _, block in numbered_blocks]
        if parts[0] is None:
            continue
        packing: dict[str, Any] = {"compression": "gzip", "shuffle": True, "fletcher32": True}
        dataset = group.create_dataset(name, data=np.concatenate(parts), **packing)
        dataset.attrs["unit"] = _UNITS.get(name, str(numbered_blocks[0][1].unit))


def _sync_folder(folder: Path) -> None:
    """Wait until the name of a new file is on the disk too."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def open_archive(data: bytes, file: Path) -> "Archive":
    """Open the content of an archive's file; arrays are read when they are asked for.

    Before that, a limited child process reads all of it once: a database may name anybody's file.

    StoreError if the data are no archive, or cannot be read within the limits.
    """
    read_untrusted(file, partial(_read_archive, data), refusal=StoreError)
    return Archive(data)


def _read_archive(data: bytes) -> None:
    Archive(data).read_all()


class Archive:
    """Content of an archive that :func:`open_archive` has checked.

    StoreError if the data are no archive; also of :meth:`cells`, if the block is not there.
    """

    def __init__(self, data: bytes) -> None:
        self._places: dict[tuple[int, int], tuple[h5py.Group, slice]] = {}
        with _readable():
            self._content = h5py.File(io.BytesIO(data), "r")
            for name, phase in _list_own_members(self._content):
                for _, group in _list_own_members(phase):
                    self._add(int(name.removeprefix("phase-")), group)

    def read_all(self) -> None:
        """Read every chunk, and the largest block in the way it is read later."""
        frame_counts = {place: frames.stop - frames.start for place, (_, frames) in self._places.items()}
        if frame_counts:
            self.cells(*max(frame_counts, key=frame_counts.__getitem__))
        with _readable():
            for group in {group for group, _ in self._places.values()}:
                for _, dataset in _list_own_members(group):
                    rows = (dataset.chunks or dataset.shape)[0]
                    for start in range(0, len(dataset), max(rows, 1)):
                        dataset[start : start + rows]

    def _add(self, phase: int, group: h5py.Group) -> None:
        arrays = dict(_list_own_members(group))
        numbers, counts = arrays.pop("block"), arrays.pop("frames")
        if not numbers.shape == counts.shape == (numbers.size,) or {numbers.dtype.kind, counts.dtype.kind} != {"i"}:
            raise ValueError(f"blocks of the shape {numbers.shape} with frames of the shape {counts.shape}")
        lengths = counts[()]
        frames = {len(array) for array in arrays.values()}
        if lengths.min(initial=1) < 1 or frames - {int(lengths.sum())}:
            raise ValueError(f"blocks of {lengths.sum()} frames in all, and arrays of {sorted(frames)}")
        start = 0
        for number, count in zip(numbers[()].tolist(), lengths.tolist(), strict=True):
            self._places[phase, number] = group, slice(start, start + count)
            start += count

    def cells(self, phase: int, block: int) -> dict[str, bytes | None]:
        """Return the arrays of a block as bytes, by column."""
        if (phase, block) not in self._places:
            run = self._content.attrs.get("run", "")
            raise StoreError(f"run {run}: its archive lacks block {block} of phase {phase}")
        group, part = self._places[phase, block]
        with _readable():
            return {
                name: np.ascontiguousarray(group[name][part], dtype=_KINDS.get(name, "<f8")).tobytes()
                if name in group
                else None
                for name in ARRAYS
            }


def _list_own_members(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """Yield the members that a group holds itself: HDF5 opens other files for links, and libraries for filters."""
    for name in group:
        item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
        is_content = item is not None
        if isinstance(item, h5py.Dataset):
            packing = item.id.get_create_plist()
            filters = {packing.get_filter(k)[0] for k in range(packing.get_nfilters())}
            is_content = not (item.external or item.is_virtual or filters - _FILTERS) and item.dtype.kind in "iuf"
        if not is_content:
            raise StoreError(f"the archive cannot be read: {name!r} is not content of an archive")
        yield name, item


@contextmanager
def _readable() -> Iterator[None]:
    try:
        yield
    except (OSError, KeyError, ValueError, TypeError, IndexError, RuntimeError, AttributeError) as error:
        raise StoreError(f"the archive cannot be read: {error}") from error
