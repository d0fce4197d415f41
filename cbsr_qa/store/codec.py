"""Sensor type, material and indenter as JSON within a run's row: a stored run needs no configuration file."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout, Electrodes, PlacedElectrodes
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.mesh_arrays import mesh_arrays, mesh_of_arrays
from cbsr_qa.domain.outlines import Polygon
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.domain.sensor import (
    GivenMesh,
    Material,
    MeasuredKernel,
    Parameter,
    QuasiStatic,
    Relaxation,
    Response,
    SensorType,
    StripRelaxation,
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
