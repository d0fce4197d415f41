"""Sheets of other outlines: accuracy against a conformal map, and meshes beside pyEIT's."""

import contextlib
import io
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.rows import Row
from benchmarks.timing import compare, fastest, shown
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.geometry.outlines import Polygon
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, PlacedElectrodes
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType, polygon_sensor
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh
from cbsr_qa.eit.mesh.triangulate import smallest_angle_deg

TITLE = "Other outlines"

_WIDTH_MM, _ARM_MM = 10.0, 60.0
_PEER_SIZE = 0.05


def rows() -> Iterator[Row]:
    """A bend with a re-entrant corner, an L-shaped mesh, and the shipped patch."""
    for order, size_mm in ((1, 1.5), (2, 3.0)):
        model, error = _bend(size_mm, order)
        yield Row(
            f"resistance of a strip with a right-angled bend, order {order}, {len(model.mesh.elements)} elements",
            "",
            f"relative error {error:.1e} against the conformal map",
        )
    yield _elbow_row()
    patch = load_sensor_type("patch-120x80mm").value
    mesh = sheet_mesh(patch, size_mm=0.06 * patch.radius_mm)
    took = fastest(lambda: sheet_mesh(patch, size_mm=0.06 * patch.radius_mm), 5)
    yield Row(
        f"forward mesh of a rounded patch with 16 pins, {len(mesh.elements)} elements",
        "",
        f"{shown(took)}, smallest angle {smallest_angle_deg(mesh.nodes_mm, mesh.elements).min():.0f}°",
    )


def _bend(size_mm: float, order: int) -> tuple[ForwardModel, float]:
    """A strip bent once: its corner counts as 1 − (2/π) ln 2 squares."""
    far = _ARM_MM + _WIDTH_MM
    outline = Polygon(((0, 0), (far, 0), (far, _WIDTH_MM), (_WIDTH_MM, _WIDTH_MM), (_WIDTH_MM, far), (0, far)))
    ends = ((far, _WIDTH_MM / 2), (_WIDTH_MM / 2, far), (0.0, far / 2))
    strips = PlacedElectrodes(ElectrodeKind.ARC, ends, _WIDTH_MM)
    sensor = polygon_sensor("bend", outline, 1.0, strips, DrivePattern(3, ((0, 1),), ((0, 1),)))
    mesh = sheet_mesh(sensor, size_mm=size_mm, order=order)
    contacts = np.array([0.1, 0.1, 1e9])  # the third closes the layout and is not there
    model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), contacts, order=order)
    exact = 2 * _ARM_MM / _WIDTH_MM + 1 - 2 / np.pi * np.log(2) + 2 * 0.1 / _WIDTH_MM
    return model, abs(model.voltages()[0, 0] / exact - 1)


def _elbow_row() -> Row:
    sensor = _elbow()
    mesh, peer = image_mesh(sensor, size_mm=_PEER_SIZE), _peer_elbow()
    compared = compare(
        f"near-uniform mesh of an L, {len(mesh.elements)} elements",
        ("ours", lambda: image_mesh(sensor, size_mm=_PEER_SIZE)),
        ("pyEIT", _peer_elbow),
        repeats=3,
    )
    own = smallest_angle_deg(mesh.nodes_mm, mesh.elements).min()
    theirs = smallest_angle_deg(np.asarray(peer.node)[:, :2], np.asarray(peer.element)).min()
    return Row(
        compared.what,
        "",
        f"{shown(compared.ours_s)}, {compared.ratio:.0f} × faster, smallest angle {own:.0f}°",
        f"{shown(compared.theirs_s)}, {len(peer.element)} elements, {theirs:.0f}°",
    )


def _elbow() -> SensorType:
    """The L that pyEIT ships: a square of side 2 without its upper right quarter."""
    outline = Polygon(((-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)))
    ends = ((0.0, -1.0), (-1.0, 0.0), (0.5, 0.0))
    strips = PlacedElectrodes(ElectrodeKind.ARC, ends, 0.1)
    return polygon_sensor("elbow", outline, 1.0, strips, DrivePattern(3, ((0, 1),), ((0, 1),)))


def _peer_elbow() -> Any:
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        from pyeit.mesh import create, shape

        corners = np.array([[-1.2, -1.2], [1.2, 1.2]])
        fixed = shape.lshape_pfix
        return create(len(fixed), h0=_PEER_SIZE, fd=shape.lshape, bbox=corners, p_fix=fixed)
