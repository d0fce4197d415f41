import numpy as np
import pytest

from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.loads.bodies import DeepTank
from cbsr_qa.testing.numerics import assert_expected_order

ANGLES = 2 * np.pi * np.arange(16) / 16
PATTERN = adjacent_pattern(16)
USED = PATTERN.usable()
PLACES = np.array([[0.5, 0.0], [0.1, 0.3], [-0.4, -0.6], [0.02, 0.0]])


def readings_of_sheet(width):
    impedance = arc_transfer_impedance(ConcentricSheet(1.0, 1.0), ANGLES, width / 2, 0.0, modes=1, harmonics=20_000)
    return (PATTERN.drive_currents().T @ impedance @ PATTERN.measure_matrix())[USED]


def test_a_shallow_tank_is_a_sheet():
    """Uniform current through each electrode on both sides; a tank of depth H has H times the conductance."""
    depth = 0.03
    tank = DeepTank(depth, ANGLES, PATTERN, electrode=0.1).readings()[USED]
    sheet = readings_of_sheet(0.1)
    # What an electrode averages differs from what it is at its ends by its width squared.
    assert np.abs(tank * depth / sheet - 1).max() < 2e-3


def test_readings_are_reciprocal_and_fall_off_faster_the_deeper_the_tank_is():
    falls = []
    for depth in (0.1, 0.5, 1.0, 2.0, 4.0):
        tank = DeepTank(depth, ANGLES, PATTERN).readings()
        np.testing.assert_allclose(tank, tank.T, rtol=1e-9, atol=1e-12)
        falls.append(tank[0, 8] / tank[0, 2])
    assert (np.diff(falls) < 0).all()


def test_turning_a_ball_by_an_electrode_turns_the_readings():
    tank = DeepTank(1.5, ANGLES, PATTERN)
    turn = ANGLES[1]
    turned = PLACES @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    before, after = (tank.changes(places, 0.15, conducts=False) for places in (PLACES, turned))
    np.testing.assert_allclose(after, np.roll(before, (1, 1), axis=(1, 2)), rtol=1e-8, atol=1e-8 * abs(before).max())


def test_second_derivatives_are_those_of_the_first():
    """Finite differences of the gradients; along z Laplace's equation gives what is missing."""
    tank, step = DeepTank(1.2, ANGLES, PATTERN), 1e-4

    def gradient(places):
        along, across = np.moveaxis(tank._derivatives(places)[0], 2, 0)
        angle = np.arctan2(places[:, 1], places[:, 0])[:, None]
        return np.stack(
            [along * np.cos(angle) - across * np.sin(angle), along * np.sin(angle) + across * np.cos(angle)], axis=2
        )

    places = PLACES[:3]
    matrix = np.stack([(gradient(places + d) - gradient(places - d)) / (2 * step) for d in step * np.eye(2)], axis=3)
    trace = matrix[..., 0, 0] + matrix[..., 1, 1]
    squares = (matrix**2).sum(axis=(2, 3)) + trace**2
    found = (tank._derivatives(places)[1] ** 2).sum(axis=2)
    np.testing.assert_allclose(found, squares, rtol=2e-3, atol=1e-4 * squares.max())


def test_the_correction_for_size_falls_with_the_square_of_the_radius():
    tank, radii = DeepTank(1.5, ANGLES, PATTERN), (0.04, 0.08, 0.16)
    point = tank.changes(PLACES, 1e-9, conducts=False)
    assert_expected_order(
        [np.abs(tank.changes(PLACES, radius, conducts=False) - point).max() for radius in radii], radii, 2.0, 1e-6
    )


def test_conductors_and_insulators_of_no_size_change_readings_the_other_way_round():
    tank = DeepTank(1.5, ANGLES, PATTERN)
    insulator, conductor = (tank.changes(PLACES, 1e-9, conducts=conducts) for conducts in (False, True))
    np.testing.assert_allclose(conductor, -2 * insulator, rtol=1e-9)


@pytest.mark.parametrize("depth", [0.05, 0.1])
def test_points_on_a_shallow_tank_are_seen_as_on_a_sheet(depth, arc_sensor):
    """An insulating point changes readings by 3/2 ∇u·∇v, on a sheet of unit conductance H² times as much."""
    problem = imaging_problem(arc_sensor(radius_mm=50.0), image_size_mm=2.5)
    inner = np.flatnonzero(np.hypot(*problem.mesh.centroids_mm.T) < 35)[::40]
    sheet = problem.jacobian[:, inner] / problem.mesh.areas_mm2[inner] * 50**2
    tank = DeepTank(depth, ANGLES, PATTERN).changes(problem.mesh.centroids_mm[inner] / 50, 1e-9, conducts=False)
    found = -tank[:, USED].T * depth**2 / 1.5
    assert np.linalg.norm(found - sheet) < 0.03 * np.linalg.norm(sheet)
