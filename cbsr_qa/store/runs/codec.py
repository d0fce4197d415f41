"""Sensor type, material and indenter as JSON in a run's row, so a stored run needs no configuration file.

Blocks of frames and samples as rows, and back with their digest checked.
"""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from cbsr_qa.domain import StoreError
from cbsr_qa.domain.geometry import Polygon
from cbsr_qa.domain.readings import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.run import Indenter
from cbsr_qa.domain.sensor import (
    DrivePattern,
    ElectrodeKind,
    ElectrodeLayout,
    Electrodes,
    GivenMesh,
    Material,
    MeasuredKernel,
    Parameter,
    PlacedElectrodes,
    QuasiStatic,
    Relaxation,
    Response,
    SensorType,
    StripRelaxation,
    mesh_arrays,
    mesh_of_arrays,
)
from cbsr_qa.store.tables import FrameBlockRow, SampleBlockRow
from cbsr_qa.store.types import digest, packed, packed_flags, unpacked, unpacked_flags


def frame_values(block: FrameBlock) -> dict[str, Any]:
    """Return the columns of a block of frames, keys of the place left out."""
    frames, drives, measures = block.voltages.shape
    own = None if block.reading_time_s is None else packed(block.reading_time_s)
    parts = packed(block.time_s), packed(block.voltages), packed_flags(block.flags), own or b""
    return {
        "frames": frames,
        "drives": drives,
        "measures": measures,
        "unit": str(block.unit),
        "current_a": block.current_A,
        "first_s": block.time_s[0],
        "last_s": block.time_s[-1],
        "time_s": parts[0],
        "voltages": parts[1],
        "flags": parts[2],
        "reading_time_s": own,
        "sha256": digest(_frame_header(block.voltages.shape, str(block.unit), block.current_A), parts),
    }


def frame_block(row: FrameBlockRow) -> FrameBlock:
    """Return the block of a row.

    Raises
    ------
    StoreError
        If what is stored is not what was measured: the digest or a length does not fit.
    """
    shape = row.frames, row.drives, row.measures
    parts = row.time_s, row.voltages, row.flags, row.reading_time_s or b""
    if digest(_frame_header(shape, row.unit, row.current_a), parts) != row.sha256:
        raise _damaged("frame", row.run, row.phase, row.block)
    return FrameBlock(
        unpacked(row.time_s, shape[:1]),
        unpacked(row.voltages, shape),
        unpacked_flags(row.flags, shape),
        VoltageUnit(row.unit),
        row.current_a,
        None if row.reading_time_s is None else unpacked(row.reading_time_s, shape),
    )


def sample_values(block: SampleBlock) -> dict[str, Any]:
    """Return the columns of a block of samples, keys of the place left out.

    Raises
    ------
    StoreError
        If a sample is not a finite number.
    """
    if not (np.isfinite(block.values).all() and np.isfinite(block.time_s).all()):
        raise StoreError(f"a sample of {block.channel} is not a finite number; it is not stored")
    parts = packed(block.time_s), packed(block.values)
    return {
        "channel": block.channel,
        "unit": block.unit,
        "samples": len(block),
        "time_s": parts[0],
        "sample_values": parts[1],
        "sha256": digest(f"{block.channel}|{block.unit}|{len(block)}", parts),
    }


def sample_block(row: SampleBlockRow) -> SampleBlock:
    """Return the block of a row; StoreError as for :func:`frame_block`."""
    if digest(f"{row.channel}|{row.unit}|{row.samples}", (row.time_s, row.sample_values)) != row.sha256:
        raise _damaged("sample", row.run, row.phase, row.block)
    shape = (row.samples,)
    return SampleBlock(row.channel, row.unit, unpacked(row.time_s, shape), unpacked(row.sample_values, shape))


def _frame_header(shape: tuple[int, ...], unit: str, current_A: float | None) -> str:
    # repr of a float is exact: the digest covers the current to the last bit.
    return f"{'x'.join(map(str, shape))}|{unit}|{None if current_A is None else float(current_A)!r}"


def _damaged(what: str, run: str, phase: int, block: int) -> StoreError:
    return StoreError(
        f"{what} block {block} of phase {phase} of run {run} is not what was measured: its digest does not match",
        remedy="restore the database from a copy; this run is not analysed",
    )


def encoded(sensor_type: SensorType, indenter: Indenter, material: Material | None = None) -> dict[str, Any]:
    """Return plain lists, numbers and texts; :func:`decoded_sensor_type` and its neighbours are the inverse."""
    kind = asdict(sensor_type)
    if sensor_type.polygon is None:
        del kind["polygon"]  # as discs have always been kept
    if sensor_type.mesh is None:
        del kind["mesh"]
    else:
        kind["mesh"] = {name: array.tolist() for name, array in mesh_arrays(sensor_type.mesh.mesh).items()}
    setting = {"sensor_type": kind, "indenter": asdict(indenter)}
    if material is not None:
        setting["material"] = asdict(material)
        if material.strip_relaxation is None:
            del setting["material"]["strip_relaxation"]  # as materials have always been kept
    return setting


def decoded_sensor_type(setting: Mapping[str, Any]) -> SensorType:
    """Return the sensor type; KeyError or TypeError where the JSON is not ours."""
    data = dict(setting["sensor_type"])
    pattern, polygon, mesh = dict(data.pop("pattern")), data.pop("polygon", None), data.pop("mesh", None)
    electrodes = _electrodes(data.pop("electrodes"))
    return SensorType(
        **{**data, "response": Response(data["response"])},
        electrodes=electrodes,
        polygon=None if polygon is None else Polygon(_points(polygon["corners_mm"]), polygon["corner_radius_mm"]),
        mesh=None if mesh is None else GivenMesh.of(mesh_of_arrays(mesh)),
        pattern=DrivePattern(pattern["electrode_count"], _pairs(pattern["drive"]), _pairs(pattern["measure"])),
    )


def decoded_indenter(setting: Mapping[str, Any]) -> Indenter:
    """Return the indenter."""
    data = setting["indenter"]
    return Indenter(data["diameter_mm"], _points(data.get("outline_mm", [])))


def decoded_material(setting: Mapping[str, Any]) -> Material:
    """Return the material."""
    data = setting["material"]
    return Material(
        name=data["name"],
        interelectrode_resistance_ohm=Parameter(**data["interelectrode_resistance_ohm"]),
        modulus_kPa=Parameter(**data["modulus_kPa"]),
        against_stress=_quasi_static(data["against_stress"]),
        against_strain=_quasi_static(data["against_strain"]),
        stress_relaxation=_relaxation(data["stress_relaxation"]),
        loading_relaxation=_relaxation(data["loading_relaxation"]),
        unloading_relaxation=_relaxation(data["unloading_relaxation"]),
        relative_noise=Parameter(**data["relative_noise"]),
        strip_relaxation=_strip(data.get("strip_relaxation")),
    )


def _electrodes(data: Mapping[str, Any]) -> Electrodes:
    kind = ElectrodeKind(data["kind"])
    if "places_mm" in data:
        return PlacedElectrodes(kind, _points(data["places_mm"]), data["width_mm"])
    return ElectrodeLayout(**{**data, "kind": kind})


def _points(data: list[list[float]]) -> tuple[tuple[float, float], ...]:
    return tuple((x, y) for x, y in data)


def _pairs(data: list[list[int]]) -> tuple[tuple[int, int], ...]:
    return tuple((plus, minus) for plus, minus in data)


def _quasi_static(data: Mapping[str, Any]) -> QuasiStatic:
    return QuasiStatic(Parameter(**data["slope"]), Parameter(**data["intercept"]), data["covariance"])


def _relaxation(data: Mapping[str, Any]) -> Relaxation:
    first, second = data["weights"]
    fast, slow = data["time_constants_s"]
    return Relaxation((first, second), (fast, slow), data["source"])


def _strip(data: Mapping[str, Any] | None) -> StripRelaxation | None:
    if data is None:
        return None
    kernels = {way: _measured(data[way]) for way in ("loading", "unloading")}
    return StripRelaxation(**{**data, **kernels})


def _measured(data: Mapping[str, Any] | None) -> MeasuredKernel | None:
    if data is None:
        return None
    tables = {
        "weights": tuple(data["weights"]),
        "time_constants_s": tuple(data["time_constants_s"]),
        "covariance": tuple(tuple(row) for row in data["covariance"]),
    }
    return MeasuredKernel(**{**data, **tables})
