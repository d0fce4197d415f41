"""Mesh files that a sensor type refers to are taken in by content, so that a stored run needs no file."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from cbsr_qa.config.documents import Document
from cbsr_qa.config.lines import line_of
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.mesh_arrays import mesh_arrays


def with_mesh(document: Document) -> Document:
    """Put the content of ``sensor_type.mesh`` in place of its name, which is looked for next to the file.

    Raises
    ------
    ConfigError
        If it cannot be read, or is no mesh a sheet can have.
    """
    sheet = document.data.get("sensor_type")
    name = sheet.get("mesh") if isinstance(sheet, Mapping) else None
    if not isinstance(name, str):
        return document
    from cbsr_qa.forward.mesh_files import read_mesh  # with all of scipy behind it

    try:
        mesh = read_mesh((document.folder or Path()) / name)
    except (NumericsError, ValueError) as error:  # a name with a NUL in it
        reason, remedy = (error.reason, error.remedy) if isinstance(error, NumericsError) else (str(error), "")
        line = line_of(document.text, ("sensor_type", "mesh"))
        where = f"line {line}: " if line else ""
        raise ConfigError(f"{document.label}: {where}sensor_type.mesh: {reason}", remedy=remedy) from error
    arrays = {key: array.tolist() for key, array in mesh_arrays(mesh).items()}
    assert isinstance(sheet, Mapping)
    return replace(document, data={**document.data, "sensor_type": {**sheet, "mesh": arrays}})
