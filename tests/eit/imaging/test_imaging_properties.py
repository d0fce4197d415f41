"""What must hold for every blob, circle and image, whatever its shape."""

import numpy as np
from drawn import drawn
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.domain.geometry import RoundFootprint
from cbsr_qa.domain.results import Blob, Image
from cbsr_qa.domain.sensor import Mesh
from cbsr_qa.eit.forward import disc_coverage
from cbsr_qa.eit.imaging.blobs import find_blobs, floored, percentage_mask
from cbsr_qa.eit.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2

CELLS = 5
coordinate = st.floats(-20, 20, allow_nan=False)
radius = st.floats(0.1, 30)


def _grid() -> Mesh:
    axis = np.linspace(-4.0, 4.0, CELLS + 1)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    corner = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)[None, :]).ravel()
    lower = np.column_stack([corner, corner + 1, corner + CELLS + 2])
    upper = np.column_stack([corner, corner + CELLS + 2, corner + CELLS + 1])
    return Mesh(nodes, np.vstack([lower, upper]).astype(np.int64))


GRID = _grid()
values = hnp.arrays(np.float64, len(GRID.elements), elements=st.floats(-5, 5, allow_subnormal=False))


@st.composite
def triangles(draw: st.DrawFn) -> Mesh:
    corners = draw(hnp.arrays(np.float64, (3, 2), elements=st.floats(-10, 10, width=32)))
    one, other = corners[1] - corners[0], corners[2] - corners[0]
    if one[0] * other[1] - one[1] * other[0] < 0:
        corners = corners[::-1].copy()
    if abs(one[0] * other[1] - one[1] * other[0]) < 1e-3:
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    return Mesh(corners, np.array([[0, 1, 2]]))


def _inside(mesh: Mesh, x: float, y: float, r: float) -> float:
    elements, share = disc_coverage(mesh, x, y, r)
    return float(share @ mesh.areas_mm2[elements])


@given(triangles(), coordinate, coordinate, radius)
@drawn(150)
def test_the_overlap_lies_between_nothing_and_either_area(mesh, x, y, r):
    area = _inside(mesh, x, y, r)
    assert 0 <= area <= float(mesh.areas_mm2[0])
    assert area <= np.pi * r**2 * (1 + 1e-9)


@given(triangles(), coordinate, coordinate, radius, st.floats(0, 5))
@drawn(100)
def test_a_larger_circle_never_covers_less(mesh, x, y, r, more):
    assert _inside(mesh, x, y, r) <= _inside(mesh, x, y, r + more) + 1e-9


@given(triangles(), coordinate, coordinate, radius, st.floats(0.05, 0.95))
@drawn(100)
def test_cutting_a_triangle_in_two_does_not_change_the_overlap(mesh, x, y, r, where):
    a, b, c = mesh.nodes_mm
    middle = a + where * (b - a)
    halves = Mesh(np.array([a, middle, b, c]), np.array([[0, 1, 3], [1, 2, 3]]))
    assert abs(_inside(halves, x, y, r) - _inside(mesh, x, y, r)) < 1e-8 * (1 + float(mesh.areas_mm2[0]))


@given(triangles(), coordinate, coordinate, radius, st.floats(0, 2 * np.pi))
@drawn(100)
def test_turning_and_shifting_everything_changes_nothing(mesh, x, y, r, angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = np.array([3.0, -7.0])
    moved = Mesh(mesh.nodes_mm @ turn.T + shift, mesh.elements)
    centre = turn @ np.array([x, y]) + shift
    one = Blob(Image(mesh, np.ones(1)), np.array([0]))
    other = Blob(Image(moved, np.ones(1)), np.array([0]))
    for metric in (area_overlap_percent, shape_deviation_mm2):
        before, after = (
            metric(one, RoundFootprint(x, y, r)),
            metric(other, RoundFootprint(float(centre[0]), float(centre[1]), r)),
        )
        assert abs(before - after) <= 1e-7 * (1 + abs(before))


@given(values, st.floats(0.01, 1), st.floats(0, 2))
@drawn(150)
def test_blobs_part_the_mask(image, fraction, floor):
    cleared = floored(image, floor)
    keep = percentage_mask(cleared, fraction)
    blobs = find_blobs(Image(GRID, cleared), keep)
    covered = np.sort(np.concatenate([blob.elements for blob in blobs])) if blobs else np.empty(0, dtype=np.int64)
    assert covered.tolist() == np.flatnonzero(keep).tolist()
    assert bool(blobs) == bool((image > floor).any())
    assert [blob.weight for blob in blobs] == sorted((blob.weight for blob in blobs), reverse=True)
    for blob in blobs:
        assert 0 <= area_overlap_percent(blob, RoundFootprint(0.5, -0.5, 2.0)) <= 100 + 1e-9
        assert shape_deviation_mm2(blob, RoundFootprint(0.5, -0.5, 2.0)) >= 0


@given(values, st.floats(0.05, 1), st.floats(0.05, 1))
@drawn(100)
def test_a_stricter_mask_keeps_a_part_of_a_laxer_one(image, one, other):
    strict, lax = (percentage_mask(image, fraction) for fraction in (max(one, other), min(one, other)))
    assert not (strict & ~lax).any()


@given(values, st.floats(1e-3, 1e3))
@drawn(100)
def test_the_unit_of_the_image_does_not_matter(image, factor):
    image = np.maximum(image, 0.0) + 0.1
    one = Blob(Image(GRID, image), np.arange(len(image)))
    other = Blob(Image(GRID, factor * image), np.arange(len(image)))
    before, after = (centre_of_mass_error_mm(blob, RoundFootprint(1.0, 2.0, 3.0)) for blob in (one, other))
    assert abs(before - after) < 1e-9
