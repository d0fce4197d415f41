"""Proposed limits as a file that a recipe takes in by ``limits_from``, or that is pasted into one."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cbsr_qa.config.limit_tables import limits_digest
from cbsr_qa.config.toml_text import one_line, toml_value
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.measurement import Limit
from cbsr_qa.files import written_whole


def limit_table(limit: Limit) -> dict[str, Any]:
    """Return a limit as a recipe's table; what it does not have is left out."""
    table = {
        "measurement": limit.measurement,
        "unit": limit.unit,
        "lower": limit.lower,
        "upper": limit.upper,
        "marginal": limit.marginal or None,
        "phase": limit.phase or None,
        "qualifier": limit.qualifier or None,
        "version": limit.version or None,
    }
    return {key: value for key, value in table.items() if value is not None}


def limits_toml(header: Mapping[str, Any], limits: Sequence[Limit], remarks: Iterable[str]) -> str:
    """Write a file of limits.

    Parameters
    ----------
    header : keys of ``[limits_version]``; the limits' own digest is added.
    remarks : comments at the top, one a line.
    """
    tables = [limit_table(limit) for limit in limits]
    sealed = {**header, "limits_sha256": limits_digest(tables)}
    lines = [f"# {one_line(remark)}" for remark in remarks]
    lines += ["", "[limits_version]", *_keys(sealed)]
    for table in tables:
        lines += ["", "[[limits]]", *_keys(table)]
    return "\n".join(lines) + "\n"


def write_new(path: Path, text: str) -> None:
    """Write a file that is not there yet, whole or not at all.

    Raises
    ------
    RefusedError
        If it exists, or its folder cannot be written to.
    """
    refuse_existing(path)
    try:
        with written_whole(path) as file:
            file.write(text.encode())
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error


def refuse_existing(path: Path) -> None:
    """Refuse to write over a file: limits that runs were judged by stay as they were."""
    try:
        there = path.exists()
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error
    if there:
        raise RefusedError(f"{path} exists already", remedy="name another file: versions of limits are kept")


def _keys(table: Mapping[str, Any]) -> Iterator[str]:
    for key, value in table.items():
        yield f"{key} = {toml_value(value)}"
