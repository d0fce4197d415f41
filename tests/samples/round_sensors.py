"""Fixtures: round sensors with pins or arcs, and their forward models."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.mesh.sheet import sheet_mesh

MakeSensor = Callable[..., SensorType]
MakeModel = Callable[..., ForwardModel]


@pytest.fixture(scope="session")
def pin_sensor() -> MakeSensor:
    def make(
        *, radius_mm: float = 50.0, count: int = 16, first_angle_deg: float = 0.0, counterclockwise: bool = True
    ) -> SensorType:
        layout = ElectrodeLayout(count, ElectrodeKind.PIN, radius_mm - 2, 0.65, first_angle_deg, counterclockwise)
        return SensorType("pins", radius_mm, 4.0, layout, adjacent_pattern(count), Response.AUTO)

    return make


@pytest.fixture(scope="session")
def arc_sensor() -> MakeSensor:
    def make(
        *,
        radius_mm: float = 1.0,
        count: int = 16,
        half_width_rad: float = 0.05,
        first_angle_deg: float = 0.0,
        counterclockwise: bool = True,
    ) -> SensorType:
        width_mm = 2 * half_width_rad * radius_mm
        layout = ElectrodeLayout(count, ElectrodeKind.ARC, radius_mm, width_mm, first_angle_deg, counterclockwise)
        return SensorType("arcs", radius_mm, 4.0, layout, adjacent_pattern(count), Response.AUTO)

    return make


@pytest.fixture(scope="session")
def model_of() -> MakeModel:
    mesh_of = lru_cache(maxsize=16)(lambda sensor, size_mm: sheet_mesh(sensor, size_mm=size_mm))

    def make(sensor: SensorType, *, size_mm: float, conductance: float = 1.0, contact: float = 0.05) -> ForwardModel:
        mesh = mesh_of(sensor, size_mm)
        return ForwardModel(
            mesh, sensor.pattern, np.full(len(mesh.elements), conductance), np.full(sensor.electrodes.count, contact)
        )

    return make
