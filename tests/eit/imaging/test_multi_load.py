"""Several loads at once: optimal assignment, what is merged, missed or made up, and parting what touches."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from disc_meshes import disc_mesh, square_mesh, uniform_blob
from drawn import drawn
from hypothesis import given, strategies as st
from tiers import rest_but

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Blob, Image, LinearReconstruction, ParameterChoice
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.eit.imaging.blobs import find_blobs
from cbsr_qa.eit.imaging.multi_load import assign_regions, loads_change, split_blobs, two_touch_resolution
from cbsr_qa.eit.inverse.problem import imaging_problem

PLACES = st.lists(st.tuples(st.floats(-30, 30), st.floats(-30, 30)), max_size=4)


def _disc(x_mm: float, y_mm: float, radius_mm: float = 2.0) -> Blob:
    return uniform_blob(disc_mesh(radius_mm, centre_mm=(x_mm, y_mm), rings=1, spokes=24))


def _load(x_mm: float, y_mm: float) -> RoundFootprint:
    return RoundFootprint(x_mm, y_mm, 6.5)


def _cost(distance: np.ndarray, gate_mm: float, chosen: tuple[int | None, ...]) -> float:
    return sum(gate_mm if k is None else min(float(distance[load, k]), gate_mm) for load, k in enumerate(chosen))


def _least_cost(distance: np.ndarray, gate_mm: float) -> float:
    """Try every assignment there is."""
    loads, regions = distance.shape
    columns = [*range(regions), *[None] * loads]
    return min(_cost(distance, gate_mm, chosen) for chosen in permutations(columns, loads))


@given(PLACES, PLACES, st.floats(2.0, 40.0))
@drawn(80)
def test_no_other_assignment_costs_less(pressed, seen, gate_mm):
    loads, regions = [_load(x, y) for x, y in pressed], [_disc(x, y) for x, y in seen]
    found = assign_regions(regions, loads, gate_mm=gate_mm)
    distance = np.array([[np.hypot(a - x, b - y) for x, y in seen] for a, b in pressed])
    distance = distance.reshape(len(loads), len(regions))
    assert _cost(distance, gate_mm, found.region_of) == pytest.approx(_least_cost(distance, gate_mm), abs=1e-6)
    owned = [k for k in found.region_of if k is not None]
    assert len(set(owned)) == len(owned)
    assert sorted([*owned, *found.false]) == list(range(len(regions)))
    for load, region in enumerate(found.region_of):
        covered = region is not None and distance[load, region] <= 2.0
        assert region is None or covered or distance[load, region] <= gate_mm


def test_each_load_has_its_own_not_its_nearest():
    """Both loads are nearest to the same region; the sum is least with the other pairing."""
    found = assign_regions([_disc(0, 0), _disc(9, 0)], [_load(-1, 0), _load(3, 0)], gate_mm=13.0)
    assert found.region_of == (0, 1)
    assert found.apart
    assert [found.name_outcome(load) for load in (0, 1)] == ["apart", "apart"]


def test_a_region_between_two_loads_is_both_of_theirs():
    found = assign_regions([_disc(0, 0, 3.0)], [_load(-8, 0), _load(8.1, 0), _load(0, 40)], gate_mm=13.0)
    assert (found.region_of, found.merged_with) == ((0, None, None), (None, 0, None))
    assert (found.merged, found.missed, found.false) == ((1,), (2,), ())
    assert [found.name_outcome(load) for load in range(3)] == ["merged", "merged", "missed"]


def test_a_region_that_covers_both_loads_is_theirs_however_far_its_centre():
    found = assign_regions([_disc(0, 0, 30.0)], [_load(-20, 0), _load(20, 0.1)], gate_mm=13.0)
    assert sorted(found.name_outcome(load) for load in (0, 1)) == ["merged", "merged"]
    assert found.false == ()


def test_beyond_the_gate_a_load_is_missed_and_the_region_false():
    found = assign_regions([_disc(20, 0)], [_load(0, 0)], gate_mm=13.0)
    assert (found.region_of, found.missed, found.false) == ((None,), (0,), (0,))
    assert not found.apart


# --- parting what touches -----------------------------------------------------------------------------------------


def _two_bumps(apart_mm: float, noise: float = 0.0) -> Image:
    mesh = square_mesh(60, size_mm=60.0)
    values = np.zeros(len(mesh.elements))
    for side in (-1, 1):
        squared = ((mesh.centroids_mm - [30 + side * apart_mm / 2, 30.0]) ** 2).sum(axis=1)
        values += np.exp(-squared / 2 / 5.0**2)
    return Image(mesh, np.maximum(values + noise * np.random.default_rng(4).standard_normal(len(values)), 0.0))


def test_touching_loads_are_parted_along_the_valley():
    image = _two_bumps(16.0)
    (joined,) = find_blobs(image, image.values > 0.25)
    left, right = sorted(split_blobs([joined], 0.05), key=lambda part: part.centre_mm()[0])
    assert left.centre_mm() == pytest.approx([22.0, 30.0], abs=0.7)
    assert right.centre_mm() == pytest.approx([38.0, 30.0], abs=0.7)
    assert np.sort(np.concatenate([left.elements, right.elements])).tolist() == joined.elements.tolist()
    # Cut along x = 30, but for one row of elements.
    mesh = image.mesh
    assert mesh.centroids_mm[left.elements, 0].max() < 31.1
    assert mesh.centroids_mm[right.elements, 0].min() > 28.9


def test_a_valley_that_is_not_deep_enough_parts_nothing():
    image = _two_bumps(12.0)
    blobs = find_blobs(image, image.values > 0.25)
    middle, peak = image.values[np.argmin(np.abs(image.mesh.centroids_mm - 30).sum(axis=1))], image.values.max()
    depth = 1 - middle / peak
    assert 0.015 < depth < 0.1
    assert len(split_blobs(blobs, depth - 0.01)) == 2
    assert split_blobs(blobs, depth + 0.01) == blobs


def test_noise_parts_nothing_below_the_prominence():
    image = _two_bumps(0.0, noise=0.02)
    blobs = [blob for blob in find_blobs(image, image.values > 0.5) if blob.area_mm2 > 5]
    assert len(split_blobs(blobs, 0.1)) == len(blobs) == 1


def test_blobs_apart_stay_as_they_were_heaviest_first():
    image = _two_bumps(40.0)
    blobs = find_blobs(image, image.values > 0.5)
    assert len(blobs) == 2
    assert split_blobs(blobs[::-1], 0.1) == blobs
    assert split_blobs((), 0.1) == ()


# --- two-touch resolution -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def blurring():
    """A stand-in for a method whose image of any conductance is its convolution with a Gaussian of known width."""
    problem = imaging_problem(load_sensor_type("disc-100mm").value, image_size_mm=4.0)
    mesh = problem.mesh
    problem = replace(
        problem,
        jacobian=np.eye(len(mesh.elements)),
        reference=np.ones(len(mesh.elements)),
        used=np.ones((1, len(mesh.elements)), dtype=bool),
    )

    def method(width_mm: float) -> LinearReconstruction:
        squared = ((mesh.centroids_mm[:, None] - mesh.centroids_mm) ** 2).sum(axis=2)
        kernel = np.exp(-squared / 2 / width_mm**2) / (2 * np.pi * width_mm**2) * mesh.areas_mm2
        return LinearReconstruction("blur", problem, kernel, ParameterChoice(0.0, "none", 1.0))

    return method


def _blurred_valley(apart_mm: float, width_mm: float) -> float:
    """Value between two discs of 13 mm over that at their peak, both blurred by a Gaussian, by quadrature."""
    axis = np.linspace(-6.5, 6.5, 53)
    x, y = (points[np.hypot(*np.meshgrid(axis, axis)) <= 6.5] for points in np.meshgrid(axis, axis))
    along = np.linspace(0, apart_mm, 60)
    one, other = (
        np.exp(-((along[:, None] - shift - x) ** 2 + y**2) / 2 / width_mm**2).sum(axis=1)
        for shift in (apart_mm / 2, -apart_mm / 2)
    )
    return float((one + other)[0] / (one + other).max())


@pytest.mark.parametrize("mask", [0.5, 0.85])
@pytest.mark.parametrize("width_mm", rest_but({8.0}, [6.0, 8.0]))
def test_two_discs_blurred_by_a_gaussian_are_parted_where_the_valley_falls_below_the_mask(blurring, mask, width_mm):
    found = two_touch_resolution(blurring(width_mm), Indenter(13.0), mask=mask, furthest_mm=36.0, step_mm=1.0)
    exact = next(d for d in np.arange(13.0, 40.0, 0.25) if _blurred_valley(float(d), width_mm) < mask)
    assert found.separation_mm == pytest.approx(exact, abs=1.5)
    assert (found.tried_mm, found.step_mm) == (36.0, 1.0)


def test_what_is_never_parted_has_no_resolution(blurring):
    found = two_touch_resolution(blurring(14.0), Indenter(13.0), mask=0.5, furthest_mm=24.0, step_mm=1.0)
    assert found.separation_mm is None
    assert found.tried_mm == 24.0


def test_a_watershed_parts_what_the_mask_does_not(blurring):
    method = blurring(6.0)
    contour, parted = (
        two_touch_resolution(method, Indenter(13.0), mask=mask, furthest_mm=30.0, step_mm=1.0) for mask in (0.5, None)
    )
    assert parted.separation_mm < contour.separation_mm


@pytest.mark.parametrize(
    ("call", "wrong", "said"),
    [
        *(
            (lambda _, gate: assign_regions([], [], gate_mm=gate), gate, "gate")
            for gate in (0.0, -1.0, np.nan, np.inf)
        ),
        *((lambda _, least: split_blobs((), least), least, "prominence") for least in (0.0, 1.0, -0.1, np.nan)),
        *(
            (lambda method, options: two_touch_resolution(method, Indenter(13.0), **options), options, "apart")
            for options in ({"step_mm": 0.0}, {"furthest_mm": 12.0}, {"step_mm": np.nan})
        ),
    ],
)
def test_gates_prominences_and_distances_that_are_none_are_refused(blurring, call, wrong, said):
    with pytest.raises(NumericsError, match=said):
        call(blurring(5.0), wrong)


def test_loads_change_every_element_by_the_share_of_it_that_they_cover():
    """Readings that are the integral of the change over the sheet see the area of each head, whatever the mesh."""
    problem = imaging_problem(load_sensor_type("disc-100mm").value, image_size_mm=4.0)
    assert np.ptp(problem.mesh.areas_mm2) > 0
    integrals = np.tile(problem.mesh.areas_mm2, (len(problem.jacobian), 1))
    change = loads_change(replace(problem, jacobian=integrals), [_load(0.0, 0.0), _load(20.0, 10.0)])
    assert change == pytest.approx(np.full(len(integrals), 2 * np.pi * 6.5**2), rel=1e-9)
