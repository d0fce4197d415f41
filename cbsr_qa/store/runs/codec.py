"""Sensor type, material and indenter as JSON in a run's row, so a stored run needs no configuration file.

Blocks of frames and samples as rows, and back with their digest checked.
"""

from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any, cast

import numpy as np
from sqlalchemy import Row

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.filling import convert_json
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.mesh import mesh_arrays, mesh_of_arrays
from cbsr_qa.domain.sensor.sensor_type import GivenMesh, Material, SensorType
from cbsr_qa.store.tables.runs import FrameBlockRow
from cbsr_qa.store.types import compact, digest, pack, pack_flags, restore, unpack, unpack_flags


def frame_values(block: FrameBlock) -> dict[str, Any]:
    """Return the columns of a block of frames, without the key columns."""
    frames, drives, measures = block.voltages.shape
    own = None if block.reading_time_s is None else pack(block.reading_time_s)
    parts = pack(block.time_s), pack(block.voltages), pack_flags(block.flags), own or b""
    return {
        "frames": frames,
        "drives": drives,
        "measures": measures,
        "unit": str(block.unit),
        "current_a": block.current_A,
        "first_s": block.time_s[0],
        "last_s": block.time_s[-1],
        "time_s": compact(parts[0], 8, steps=True),
        "voltages": compact(parts[1], 8),
        "flags": compact(parts[2], 1),
        "reading_time_s": None if own is None else compact(own, 8, steps=True),
        "sha256": digest(frame_header(block.voltages.shape, str(block.unit), block.current_A), parts),
    }


def frame_block(row: Row[Any] | FrameBlockRow) -> FrameBlock:
    """Return the block of a row.

    Raises
    ------
    StoreError
        If the digest or a length does not match.
    """
    shape = row.frames, row.drives, row.measures
    parts = check_frames(row)
    return FrameBlock(
        unpack(parts[0], shape[:1]),
        unpack(parts[1], shape),
        unpack_flags(parts[2], shape),
        VoltageUnit(row.unit),
        row.current_a,
        None if row.reading_time_s is None else unpack(parts[3], shape),
    )


def check_frames(row: Row[Any] | FrameBlockRow) -> tuple[bytes, bytes, bytes, bytes]:
    """Return the arrays of a row as they were measured; StoreError if they do not match their digest."""
    readings, own = row.frames * row.drives * row.measures, row.reading_time_s
    try:
        parts = (
            restore(row.time_s, 8 * row.frames, 8, steps=True),
            restore(row.voltages, 8 * readings, 8),
            restore(row.flags, readings, 1),
            b"" if own is None else restore(own, 8 * readings, 8, steps=True),
        )
    except ValueError as error:
        raise damage_error("frame", row.run, row.phase, row.block) from error
    shape = row.frames, row.drives, row.measures
    if digest(frame_header(shape, row.unit, row.current_a), parts) != row.sha256:
        raise damage_error("frame", row.run, row.phase, row.block)
    return parts


def sample_values(block: SampleBlock) -> dict[str, Any]:
    """Return the columns of a block of samples, without the key columns."""
    if not (np.isfinite(block.values).all() and np.isfinite(block.time_s).all()):
        raise StoreError(f"a sample of {block.channel} is not a finite number; it is not stored")
    parts = pack(block.time_s), pack(block.values)
    return {
        "channel": block.channel,
        "unit": block.unit,
        "samples": len(block),
        "time_s": compact(parts[0], 8, steps=True),
        "sample_values": compact(parts[1], 8),
        "sha256": digest(sample_header(block.channel, block.unit, len(block)), parts),
    }


def sample_block(row: Row[Any]) -> SampleBlock:
    """Return the block of a row; StoreError as for :func:`frame_block`."""
    return SampleBlock(row.channel, row.unit, *(unpack(part, (row.samples,)) for part in check_samples(row)))


def check_samples(row: Row[Any]) -> tuple[bytes, bytes]:
    """Return the arrays of a row as they were measured; StoreError if they do not match their digest."""
    size = 8 * row.samples
    try:
        parts = restore(row.time_s, size, 8, steps=True), restore(row.sample_values, size, 8)
    except ValueError as error:
        raise damage_error("sample", row.run, row.phase, row.block) from error
    if digest(sample_header(row.channel, row.unit, row.samples), parts) != row.sha256:
        raise damage_error("sample", row.run, row.phase, row.block)
    return parts


def frame_header(shape: tuple[int, ...], unit: str, current_A: float | None) -> str:
    """Return what the digest of frames covers beside their arrays."""
    # repr of a float is exact: the digest covers the current to the last bit.
    return f"{'x'.join(map(str, shape))}|{unit}|{None if current_A is None else float(current_A)!r}"


def sample_header(channel: str, unit: str, samples: int) -> str:
    """Return what the digest of samples covers beside their arrays."""
    return f"{channel}|{unit}|{samples}"


def damage_error(what: str, run: str, phase: int, block: int) -> StoreError:
    """Return the error for a block that does not match its digest."""
    return StoreError(
        f"{what} block {block} of phase {phase} of run {run} is not what was measured: its digest does not match",
        remedy="restore the database from a copy; this run is not analysed",
    )


def encode_setting(sensor_type: SensorType, indenter: Indenter, material: Material | None = None) -> dict[str, Any]:
    """Return plain lists, numbers and texts; :func:`decode_sensor_type` and its neighbours are the inverse."""
    kind = asdict(sensor_type)
    if sensor_type.polygon is None:
        del kind["polygon"]  # discs have always been stored without
    if sensor_type.mesh is None:
        del kind["mesh"]
    else:
        kind["mesh"] = {name: array.tolist() for name, array in mesh_arrays(sensor_type.mesh.mesh).items()}
    setting = {"sensor_type": kind, "indenter": asdict(indenter)}
    if material is not None:
        setting["material"] = asdict(material)
        if material.strip_relaxation is None:
            del setting["material"]["strip_relaxation"]  # materials have always been stored without
    return setting


def decode_sensor_type(setting: Mapping[str, Any]) -> SensorType:
    """Return the sensor type; KeyError, TypeError or ValueError where the JSON is not ours."""
    data = dict(setting["sensor_type"])
    mesh = data.pop("mesh", None)
    sensor_type: SensorType = convert_json(SensorType, data)
    return sensor_type if mesh is None else replace(sensor_type, mesh=GivenMesh.from_mesh(mesh_of_arrays(mesh)))


def decode_indenter(setting: Mapping[str, Any]) -> Indenter:
    """Return the indenter; errors as for :func:`decode_sensor_type`."""
    return cast(Indenter, convert_json(Indenter, setting["indenter"]))


def decode_material(setting: Mapping[str, Any]) -> Material:
    """Return the material; errors as for :func:`decode_sensor_type`."""
    return cast(Material, convert_json(Material, setting["material"]))
