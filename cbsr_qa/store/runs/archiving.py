"""Moves frames of runs to archives and back. At every moment all are in the database, in a file, or in both."""

import hashlib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from sqlalchemy import Connection, Engine, delete, exists, func, insert, select, update

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.archives import (
    ARRAYS,
    archive_bytes,
    archive_root,
    archive_row,
    file_at,
    open_archive,
    place_of,
    read_checked,
    with_arrays,
    with_cells,
    write_archive,
)
from cbsr_qa.store.chain.check import check_run
from cbsr_qa.store.engine import reading, sqlite_file, writing
from cbsr_qa.store.locks import this_process, writing_alone
from cbsr_qa.store.runs.codec import frame_block, frame_values
from cbsr_qa.store.runs.verdicts import verdict_of
from cbsr_qa.store.tables.records import ArchiveRow, VerdictOverrideRow
from cbsr_qa.store.tables.runs import FrameBlockRow, RunRow, RunStateRow

_PASSED = (Outcome.PASS, Outcome.MARGINAL)
#: More than HDF5 needs beside the arrays of an archive, and of each block.
_ARCHIVE_BYTES: Final = 2**20
_BLOCK_BYTES: Final = 2**16


@dataclass(frozen=True, slots=True)
class ArchivedRun:
    """A run whose frames were, or would be, archived.

    Parameters
    ----------
    frames : their number.
    database_bytes : of their arrays in the database.
    file, file_bytes : of the archive; empty and 0 if it is not written.
    """

    run: str
    serial: str
    frames: int
    database_bytes: int
    file: str = ""
    file_bytes: int = 0


class RunArchives:
    """Archives of the frames of runs."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def find_archivable(self, before: datetime) -> tuple[ArchivedRun, ...]:
        """Return the runs whose frames may be archived, oldest first.

        They finished, and every session of them began, before a time; their latest verdict is a pass or marginal,
        and so is the sensor's; no verdict of the run was overridden.
        """
        run, row = RunRow, FrameBlockRow
        size = sum((func.coalesce(func.length(getattr(row, name)), 0) for name in ARRAYS), start=0)
        query = (
            select(run.run, run.serial, func.sum(row.frames), func.sum(size))
            .join(row, row.run == run.run)
            .where(run.started_at < before, func.length(row.voltages) > 0)
            .where(~exists().where(ArchiveRow.run == run.run), ~exists().where(VerdictOverrideRow.run == run.run))
            .group_by(run.run, run.serial)
            .order_by(run.run)
        )
        with reading(self._engine) as connection:
            runs = [
                ArchivedRun(run_id, serial, int(n), int(size))
                for run_id, serial, n, size in connection.execute(query)
            ]
            return tuple(run for run in runs if _has_passed(connection, run, before))

    def choose_folder(self, to: Path | None) -> Path:
        """Return the folder of new archives: by default beside a SQLite file, or the root of a server's archives.

        StoreError if the database could not name a file in it, see :func:`~cbsr_qa.store.archives.place_of`.
        """
        database, root = sqlite_file(self._engine.url), archive_root(self._engine)
        beside = root if database is None else database.with_name(f"{database.stem}-archive")
        folder = to or beside or Path()
        place_of(self._engine, folder / "run.h5")
        return folder

    def archive(self, run: ArchivedRun, folder: Path, at: datetime) -> ArchivedRun:
        """Move the frames of a run to a file.

        The file is on the disk, and was read back and compared with the database, before the arrays go from the rows.

        Raises
        ------
        StoreError
            If the run was altered or is being written, or the file cannot be written or is another one; nothing is
            changed in the database then.
        """
        file = folder / f"{run.run}.h5"
        with writing_alone(self._engine, run.run, this_process("")):
            with reading(self._engine) as connection:
                check_run(connection, run.run)
                rows = _rows(connection, run.run)
                blocks = [(row.phase, row.block, frame_block(row)) for row in with_arrays(connection, rows)]
            if not file.exists():
                write_archive(file, run.run, blocks)
            # Uncompressed, with HDF5's own, an archive takes less.
            max_bytes = _ARCHIVE_BYTES + sum(3 * block.voltages.nbytes + _BLOCK_BYTES for _, _, block in blocks)
            data = _verify(file, rows, max_bytes)
            values = {
                "run": run.run,
                "file": place_of(self._engine, file),
                "file_bytes": len(data),
                "file_sha256": hashlib.sha256(data).hexdigest(),
                "archived_at": at,
            }
            with writing(self._engine) as connection:
                connection.execute(insert(ArchiveRow), values)
                _empty(connection, run.run)
        return ArchivedRun(run.run, run.serial, run.frames, run.database_bytes, str(file), len(data))

    def unarchive(self, run: str) -> ArchivedRun:
        """Bring the frames of a run back; its file stays, as copies of the database may name it.

        Raises
        ------
        StoreError
            If the run is not archived, or its file is missing or altered; nothing is changed then.
        """
        with writing_alone(self._engine, run, this_process("")), writing(self._engine) as connection:
            row, data = archive_row(connection, run), read_checked(connection, run)
            if row is None or data is None:
                raise StoreError(f"the frames of run {run} are not archived")
            frames, size = 0, 0
            for block_row in with_arrays(connection, _rows(connection, run)):
                block = frame_block(block_row)
                values = {name: value for name, value in frame_values(block).items() if name in ARRAYS}
                of_run = update(FrameBlockRow).where(FrameBlockRow.run == run)
                of_block = FrameBlockRow.phase == block_row.phase, FrameBlockRow.block == block_row.block
                connection.execute(of_run.where(*of_block).values(**values))
                frames += len(block)
                size += sum(len(value) for value in values.values() if value is not None)
            connection.execute(delete(ArchiveRow).where(ArchiveRow.run == run))
            serial = str(connection.scalar(select(RunRow.serial).where(RunRow.run == run)))
            file = file_at(self._engine, row.file)
        return ArchivedRun(run, serial, frames, size, str(file), len(data))


def _has_passed(connection: Connection, candidate: ArchivedRun, before: datetime) -> bool:
    """Whether a run finished long ago and passed, and so did the latest run of its sensor that has a verdict."""
    states = select(RunStateRow.end, RunStateRow.noted_at).where(RunStateRow.run == candidate.run)
    sessions = connection.execute(states.order_by(RunStateRow.number)).all()
    if not sessions or sessions[-1].end != EndReason.FINISHED:
        return False
    if any(session.noted_at is not None and session.noted_at >= before for session in sessions):
        return False
    own = verdict_of(connection, candidate.run)
    if own is None or own.outcome not in _PASSED:
        return False
    of_sensor = select(RunRow.run).where(RunRow.serial == candidate.serial).order_by(RunRow.run.desc())
    for run in connection.scalars(of_sensor).all():
        verdict = verdict_of(connection, run)
        if verdict is not None and (
            verdict.altered or verdict.outcome is not None
        ):  # altered: what it was is not known
            return verdict.outcome in _PASSED
    return False


def _verify(file: Path, rows: list[Any], max_bytes: int) -> bytes:
    """Return the content of an archive that holds every block of some rows, to the bit."""
    try:
        data = archive_bytes(file, max_bytes)
    except OSError as error:
        raise StoreError(
            f"{file} cannot be read: {error.strerror}", remedy="move that file away, or use --to"
        ) from error
    try:
        archive = open_archive(data, file)
        for row in rows:
            frame_block(with_cells(row, archive.cells(row.phase, row.block)))
    except StoreError as error:
        raise StoreError(f"{file}: {error.reason}", remedy="move that file away, or use --to") from error
    return data


def _empty(connection: Connection, run: str) -> None:
    of_run = update(FrameBlockRow).where(FrameBlockRow.run == run)
    connection.execute(of_run.values(time_s=b"", voltages=b"", flags=b""))
    connection.execute(of_run.where(FrameBlockRow.reading_time_s.is_not(None)).values(reading_time_s=b""))


def _rows(connection: Connection, run: str) -> list[Any]:
    row = FrameBlockRow
    query = select(*row.__table__.columns).where(row.run == run).order_by(row.phase, row.block)
    return list(connection.execute(query).all())
