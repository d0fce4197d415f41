import json

import numpy as np
import pytest

from benchmarks.reference_solutions import point_transfer_impedance
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance

ANGLES = 2 * np.pi * np.arange(16) / 16
PATTERN = adjacent_pattern(16)


def readings(impedance: np.ndarray) -> np.ndarray:
    return (impedance @ PATTERN.drive_currents()).T @ PATTERN.measure_matrix()


@pytest.mark.rest
def test_arcs_agree_with_published_reference_numbers(shared):
    cases = json.loads((shared / "oracle" / "analytic_cem_pem.json").read_text())["cases"]
    assert len(cases) == 6
    for case in cases:
        sheet = ConcentricSheet(1.0, 1.0, case["a"], case["s_i"])
        row = arc_transfer_impedance(sheet, ANGLES, case["hw"], case["z"], harmonics=60_000)[0]
        expected = np.array(case["row0"])
        assert np.abs(row - expected).max() < max(3 * case["self_convergence"], 2e-8) * np.abs(expected).max()


def test_points_agree_with_published_reference_numbers(shared):
    cases = json.loads((shared / "oracle" / "analytic_cem_pem.json").read_text())["pem_adjacent_drive0"]
    assert cases
    for case in cases:
        impedance = point_transfer_impedance(ConcentricSheet(1.0, 1.0, case["a"], case["s_i"]), ANGLES)
        found = readings(impedance)[0][PATTERN.usable()[0]]
        assert np.abs(found - case["drive0"]).max() < 1e-14


def test_small_arcs_tend_to_points():
    points = readings(point_transfer_impedance(ConcentricSheet(1.0, 1.0, 0.6, 4.0), ANGLES))
    usable = PATTERN.usable()
    error = []
    for half_width in (0.04, 0.02, 0.01):
        sheet = ConcentricSheet(1.0, 1.0, 0.6, 4.0)
        arcs = readings(arc_transfer_impedance(sheet, ANGLES, half_width, 1.0, modes=6, harmonics=20_000))
        error.append(np.abs((arcs - points)[usable]).max())
    assert np.allclose(np.diff(np.log(error)), -2 * np.log(2), rtol=0.05)  # second order in the width


def test_high_contact_impedance_makes_the_current_uniform():
    sheet, width = ConcentricSheet(1.0, 1.0), 0.1
    gap = arc_transfer_impedance(sheet, ANGLES, width / 2, 0.0, modes=1, harmonics=20_000)
    for z, allowed in ((1e2, 1e-4), (1e4, 1e-6)):
        full = arc_transfer_impedance(sheet, ANGLES, width / 2, z, modes=12, harmonics=20_000)
        contacts = z / width * (np.eye(16) - 1 / 16)
        assert np.abs(full - contacts - gap).max() < allowed


def test_impossible_sheets_are_refused():
    with pytest.raises(NumericsError, match="does not fit"):
        ConcentricSheet(1.0, 1.0, 1.0, 2.0)
    with pytest.raises(NumericsError, match="must be positive"):
        ConcentricSheet(1.0, -1.0)
