"""Formats of exported files: which one a path or ``--format`` means, and whether it may be written there."""

from enum import StrEnum
from pathlib import Path
from typing import Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import did_you_mean
from cbsr_qa.system.files import writing
from cbsr_qa.system.words import echo


class ExportFormat(StrEnum):
    """Kind of file."""

    CSV = "csv"
    PARQUET = "parquet"
    JUNIT = "junit"
    RECORDING = "recording"
    NETCDF = "netcdf"
    EIDORS = "eidors"

    @property
    def of_frames(self) -> bool:
        """Whether the file holds the frames of one run."""
        return self in (ExportFormat.RECORDING, ExportFormat.NETCDF, ExportFormat.EIDORS)

    @property
    def of_table(self) -> bool:
        """Whether the file is a table."""
        return self in (ExportFormat.CSV, ExportFormat.PARQUET)


class ExportTable(StrEnum):
    """What a row of a table is."""

    RUNS = "runs"
    MEASUREMENTS = "measurements"


_SUFFIXES: Final = {
    ".csv": ExportFormat.CSV,
    ".parquet": ExportFormat.PARQUET,
    ".xml": ExportFormat.JUNIT,
    ".h5": ExportFormat.RECORDING,
    ".hdf5": ExportFormat.RECORDING,
    ".nc": ExportFormat.NETCDF,
    ".mat": ExportFormat.EIDORS,
}


def format_of(to: Path, given: str | None) -> ExportFormat:
    """Return the format that was given, else that of the suffix. Raise RefusedError if neither names a format."""
    if given is not None:
        if given not in list(ExportFormat):
            known_formats = ", ".join(ExportFormat)
            hint = f"{did_you_mean(given, [*map(str, ExportFormat)])} allowed: {known_formats}".lstrip()
            raise RefusedError(f"--format {echo(given, 64)} is not known", remedy=hint)
        return ExportFormat(given)
    if to.suffix.lower() not in _SUFFIXES:
        known_formats = ", ".join(f"{suffix} ({kind})" for suffix, kind in _SUFFIXES.items())
        problem = f"unknown suffix {echo(to.suffix, 64)}" if to.suffix else "no suffix"
        raise RefusedError(f"{to}: {problem}", remedy=f"use one of {known_formats}, or name a format with --format")
    return _SUFFIXES[to.suffix.lower()]


def check_target(to: Path, *, force: bool) -> None:
    """Refuse a path that cannot be written, or a file that exists unless ``force`` allows to replace it."""
    with writing(to):
        exists = to.is_symlink() or to.exists()
        folder = to.is_dir()
        home = to.parent.is_dir()
    if folder:
        raise RefusedError(f"{to} is a folder", remedy="name a file in it")
    if not home:
        raise RefusedError(f"{to} cannot be written: there is no folder {to.parent}", remedy="make the folder first")
    if exists and not force:
        raise RefusedError(f"{to} exists already", remedy="name another file, or replace it with --force")
