from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.overlap import overlap_fractions, overlap_pieces
from cbsr_qa.eit.inverse.problem import image_jacobian, imaging_problem, nominal_model, target_signal
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh
from cbsr_qa.testing.numerics import assert_adjoint


def test_image_jacobian_of_linear_elements_is_the_forward_one_through_the_overlap(pin_sensor, model_of):
    """Their fields are constant on each element: cutting it by area is exact."""
    sensor = pin_sensor(count=8)
    model, mesh = model_of(sensor, size_mm=6.0), image_mesh(sensor, size_mm=7.0)
    drive, measure = np.nonzero(sensor.pattern.usable())
    share = overlap_fractions(model.mesh, mesh)
    sensitivity = model.jacobian()[drive, measure]
    found = image_jacobian(model, mesh, drive, measure)
    assert_adjoint(
        lambda image: found @ image,
        lambda readings: share.T @ (sensitivity.T @ readings),
        (len(mesh.elements),),
        drive.shape,
    )


def test_image_jacobian_of_quadratic_elements_converges_with_second_order(pin_sensor):
    sensor = pin_sensor(count=8)
    drive, measure = np.nonzero(sensor.pattern.usable())
    mesh, sizes = image_mesh(sensor, size_mm=8.0), (12.0, 6.0, 3.0)
    found = []
    for size_mm in sizes:
        fine = sheet_mesh(sensor, size_mm=size_mm)
        model = ForwardModel(fine, sensor.pattern, np.ones(len(fine.elements)), np.full(8, 0.5), order=2)
        found.append(image_jacobian(model, mesh, drive, measure))
    inner = np.hypot(*mesh.centroids_mm.T) < 35  # behind the pins the edge's polygons and the pins' own size rule
    errors = [np.linalg.norm((each - found[-1])[:, inner]) for each in found[:-1]]
    assert errors[1] < errors[0] * (sizes[1] / sizes[0]) ** 1.7
    assert errors[1] < 0.01 * np.linalg.norm(found[-1][:, inner])


def test_nominal_jacobian_has_the_signs_and_the_symmetry_of_its_readings(pin_sensor):
    sensor = pin_sensor()
    skipping = tuple((k, (k + 3) % 16) for k in range(16))
    turned = tuple(pair[::-1] if k % 2 else pair for k, pair in enumerate(skipping))
    pattern = DrivePattern(16, skipping, turned)
    problem = imaging_problem(replace(sensor, pattern=pattern), image_size_mm=8.0)
    model = nominal_model(problem.sensor_type)
    drive, measure = np.nonzero(problem.used)
    expected = image_jacobian(model, problem.mesh, drive, measure)
    assert np.abs(problem.jacobian - expected).max() < 1e-10 * np.abs(expected).max()


def test_image_jacobian_predicts_a_simulated_target(pin_sensor):
    problem = imaging_problem(pin_sensor(), image_size_mm=3.0)
    for x_mm, y_mm in ((0.0, 0.0), (30.0, 0.0), (-15.0, 15.0)):
        elements, fraction = disc_coverage(problem.mesh, x_mm, y_mm, 6.5)
        predicted = problem.jacobian[:, elements] @ fraction * 1e-3
        simulated = target_signal(problem, x_mm=x_mm, y_mm=y_mm, radius_mm=6.5, contrast=1e-3)
        assert np.linalg.norm(predicted - simulated) < 0.008 * np.linalg.norm(simulated)


# --- overlap of meshes ---


@pytest.fixture(scope="module")
def meshes(pin_sensor) -> tuple[Mesh, Mesh]:
    sensor = pin_sensor()
    return sheet_mesh(sensor, size_mm=4.0), image_mesh(sensor, size_mm=5.0)


def test_a_mesh_lies_in_itself(meshes):
    _, coarse = meshes
    share = overlap_fractions(coarse, coarse)
    assert np.allclose(share.diagonal(), 1, atol=1e-12)
    assert abs(share.sum() - len(coarse.elements)) < 1e-9


def test_nothing_is_lost_and_area_arrives_where_it_lies(meshes):
    fine, coarse = meshes
    share = overlap_fractions(fine, coarse)
    assert np.allclose(np.asarray(share.sum(axis=1)).ravel(), 1, atol=1e-12)
    arrived = share.T @ fine.areas_mm2
    inner = np.hypot(*coarse.centroids_mm.T) < 40  # away from pins and from the two polygons' edges
    assert np.allclose(arrived[inner], coarse.areas_mm2[inner], rtol=1e-9)


def test_pieces_lie_where_they_should(meshes):
    """First moments of the pieces of every inner element add up to its own, on either mesh."""
    fine, coarse = meshes
    pieces = overlap_pieces(fine, coarse)
    moments = pieces.areas_mm2[:, None] * pieces.centroids_mm
    for mesh, owner in ((fine, pieces.fine), (coarse, pieces.coarse)):
        inner = np.hypot(*mesh.centroids_mm.T) < 40
        for axis in range(2):
            found = np.bincount(owner, moments[:, axis], minlength=len(mesh.elements))
            expected = mesh.areas_mm2 * mesh.centroids_mm[:, axis]
            assert np.abs(found - expected)[inner].max() < 1e-8 * np.abs(expected).max()
