"""What must hold for every blob, circle and image, whatever its shape."""

import numpy as np
from drawn import drawn
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.domain.geometry import RoundFootprint
from cbsr_qa.domain.results import Blob, Image
from cbsr_qa.domain.sensor import Mesh
from cbsr_qa.eit.imaging.blobs import find_blobs, floored, percentage_mask
from cbsr_qa.eit.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2

CELLS = 5


def _grid() -> Mesh:
    axis = np.linspace(-4.0, 4.0, CELLS + 1)
    nodes = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    corner = (np.arange(CELLS)[:, None] * (CELLS + 1) + np.arange(CELLS)[None, :]).ravel()
    lower = np.column_stack([corner, corner + 1, corner + CELLS + 2])
    upper = np.column_stack([corner, corner + CELLS + 2, corner + CELLS + 1])
    return Mesh(nodes, np.vstack([lower, upper]).astype(np.int64))


GRID = _grid()
values = hnp.arrays(np.float64, len(GRID.elements), elements=st.floats(-5, 5, allow_subnormal=False))


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
