"""Figures of merit: what a frame costs, what a mask alone costs in accuracy, and how close two loads may be."""

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import Row
from benchmarks.timing import compare, fastest, shown
from cbsr_qa.config.loader import load_recipe, load_sensor_type
from cbsr_qa.domain.geometry.footprints import Footprint, PolygonFootprint, RoundFootprint
from cbsr_qa.domain.imaging import Image, Region
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Indenter
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.imaging.blobs import find_blobs_by_mask, nearest_blob, subtract_noise_floor
from cbsr_qa.eit.imaging.contours import find_contours_by_mask
from cbsr_qa.eit.imaging.multi_load import two_touch_resolution
from cbsr_qa.eit.imaging.shape import spatial_figures
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.mesh.sheet import image_mesh
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind

TITLE = "Figures of merit"

_MASKS = (0.25, 0.5, 0.75, 0.85)
_PLACE = (15.0, 15.0)
_RADIUS_MM = 6.5
_HEAD = RoundFootprint(*_PLACE, _RADIUS_MM)
_GOAL_S = 2e-3


def rows() -> Iterator[Row]:
    """Time of a frame with the paper's element loop beside it, then accuracy."""
    mesh = image_mesh(load_sensor_type("disc-100mm").value, size_mm=2.45)
    noise = np.random.default_rng(1).standard_normal((8, len(mesh.elements)))
    frame = _bump(mesh, *_PLACE, width_mm=9.0) + 0.01 * noise[0]
    floor = 0.01 * float(np.abs(noise).max())
    yield _time_row("contours", mesh, frame, floor)
    yield _time_row("whole elements", mesh, frame, floor)
    yield _polygon_row(mesh, frame, floor)
    for size_mm in (3.0, 2.45):
        yield from _mask_rows(size_mm)
    yield _two_touch_row()


def _bump(mesh: Mesh, x_mm: float, y_mm: float, width_mm: float) -> NDArray[np.float64]:
    values: NDArray[np.float64] = np.exp(
        -((mesh.centroids_mm - np.array([x_mm, y_mm])) ** 2).sum(axis=1) / width_mm**2
    )
    return values


def _figures(mesh: Mesh, frame: NDArray[np.float64], floor: float, head: Footprint, *, contours: bool) -> None:
    image = Image(mesh, subtract_noise_floor(frame, floor))
    found = find_contours_by_mask(image, _MASKS) if contours else find_blobs_by_mask(image, _MASKS)
    sensed: list[Region | None] = [nearest_blob(regions, *head.centre_mm) for regions in found]
    assert all(spatial_figures(sensed, head))


def _circle_mask(mesh: Mesh) -> list[int]:
    """The paper's code: one circle mask, element by element."""
    inside = []
    for number, element in enumerate(mesh.elements):
        centre = mesh.nodes_mm[element].mean(axis=0)
        if np.linalg.norm(centre - _PLACE) <= _RADIUS_MM:
            inside.append(number)
    return inside


def _time_row(outline: str, mesh: Mesh, frame: NDArray[np.float64], floor: float) -> Row:
    compared = compare(
        f"noise floor, four masks, regions by {outline}, E_CoM, A_OL, SD, {len(mesh.elements)} elements",
        ("all of it", lambda: _figures(mesh, frame, floor, _HEAD, contours=outline == "contours")),
        ("one circle mask by a loop over the elements, as in the paper's code", lambda: _circle_mask(mesh)),
        repeats=40,
    )
    return Row(
        compared.what,
        f"≤ {shown(_GOAL_S)} a frame",
        shown(compared.ours_s),
        f"{compared.theirs}: {shown(compared.theirs_s)}",
        compared.ours_s <= _GOAL_S,
    )


def _polygon_row(mesh: Mesh, frame: NDArray[np.float64], floor: float) -> Row:
    ell = np.array([[-6, -6], [8, -6], [8, 0], [0, 0], [0, 8], [-6, 8]], dtype=np.float64) + np.array(_PLACE)
    taken = fastest(lambda: _figures(mesh, frame, floor, PolygonFootprint(ell), contours=True), 20)
    return Row("the same against a head of six corners, one of them concave", "", shown(taken))


def _mask_rows(size_mm: float) -> Iterator[Row]:
    """What the 85 % mask alone costs on a perfect image: a bump whose 85 % contour is the head."""
    mesh = image_mesh(load_sensor_type("disc-100mm").value, size_mm=size_mm)
    width_mm = _RADIUS_MM / np.sqrt(-np.log(0.85))
    random = np.random.default_rng(7)
    scores: dict[str, list[tuple[float, float, float]]] = {"contours": [], "whole elements": []}
    for x_mm, y_mm in NINE_LOCATIONS_MM:
        for away in random.uniform(-1.5, 1.5, (10, 2)):
            x, y = x_mm + float(away[0]), y_mm + float(away[1])
            image, head = Image(mesh, _bump(mesh, x, y, width_mm)), RoundFootprint(x, y, _RADIUS_MM)
            for name, find in (("contours", find_contours_by_mask), ("whole elements", find_blobs_by_mask)):
                (found,) = spatial_figures([nearest_blob(find(image, (0.85,))[0], x, y)], head)
                assert found is not None
                scores[name].append((found.error_mm, found.overlap_percent, found.deviation_mm2))
    for name, found_at in scores.items():
        error, overlap, deviation = np.mean(found_at, axis=0)
        worst = max(score[0] for score in found_at)
        yield Row(
            f"a perfect image at 90 places, 85 % mask by {name}, {len(mesh.elements)} elements of {size_mm:g} mm",
            "",
            f"E_CoM {error:.3f} mm (worst {worst:.2f}), A_OL {overlap:.1f} %, SD {deviation:.3f} mm²",
        )


def _two_touch_row() -> Row:
    chosen = load_recipe("nine-locations").value.reconstruction
    method = discover().factory(Kind.RECONSTRUCTION, chosen.name)(**chosen.options)
    prepared = method.prepare(imaging_problem(load_sensor_type("disc-100mm").value))
    before = time.perf_counter()
    contour = two_touch_resolution(prepared, Indenter(2 * _RADIUS_MM))
    taken = time.perf_counter() - before
    parted = two_touch_resolution(prepared, Indenter(2 * _RADIUS_MM), mask=None)
    return Row(
        f"two-touch resolution of {chosen.name}, heads of 13 mm",
        "",
        f"{contour.separation_mm} mm by contours at 85 %, {parted.separation_mm} mm by watershed; {shown(taken)}",
    )
