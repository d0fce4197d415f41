"""Sensor types of any outline in files: what a user writes, and what a mistake in it says."""

import numpy as np
import pytest

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.geometry.outlines import Disc
from cbsr_qa.domain.sensor.electrodes import PlacedElectrodes

OUTLINE = "outline_mm = [[-60, -40], [60, -40], [60, 40], [-60, 40]]"
PINS = """kind = "pin"
diameter_mm = 1.0
positions_mm = [[-55, -35], [0, -35], [55, -35], [55, 0], [55, 35], [0, 35], [-55, 35], [-55, 0]]"""


@pytest.fixture
def write(tmp_path):
    def path(sheet=OUTLINE, electrodes=PINS, pattern=""):
        file = tmp_path / "own.toml"
        head = f'[sensor_type]\nname = "own"\nthickness_mm = 2.0\n{sheet}\n'
        file.write_text(f"{head}[electrodes]\n{electrodes}\n[pattern]\n{pattern}\n")
        return file

    return path


@pytest.fixture
def refused(write):
    def message(**changed):
        with pytest.raises(ConfigError) as caught:
            load_sensor_type(write(**changed))
        assert "own.toml has " in str(caught.value)
        return str(caught.value)

    return message


def test_the_shipped_patch_is_a_rounded_rectangle_with_pins_inside_it():
    patch = load_sensor_type("patch-120x80mm").value
    assert patch.outline.extent_mm == (-60.0, 60.0, -40.0, 40.0)
    assert patch.outline.curve.area == pytest.approx(9600 - (4 - np.pi) * 100)
    np.testing.assert_allclose(patch.outline.clearance_mm(patch.electrodes.positions_mm()), 3.0, atol=1e-9)
    assert patch.electrodes.electrode_at(1.0, 0.0) == pytest.approx(0.0)
    assert patch.electrodes.electrode_at(0.0, 1.0) == pytest.approx(4.0)
    assert patch.pattern.usable().sum() == 208


def test_pins_may_be_placed_one_by_one_on_a_disc(write):
    sensor = load_sensor_type(write(sheet="radius_mm = 70.0")).value
    assert sensor.outline == Disc(70.0)
    assert isinstance(sensor.electrodes, PlacedElectrodes)


def test_a_ring_of_pins_may_lie_in_a_polygon(write):
    ring = 'kind = "pin"\ncount = 8\nring_radius_mm = 35.0\ndiameter_mm = 1.0'
    assert load_sensor_type(write(electrodes=ring)).value.electrodes.count == 8


@pytest.mark.parametrize("rule", ["adjacent", "skip-2", "opposite"])
def test_rules_and_lists_of_pairs_mean_the_same(write, rule):
    named = load_sensor_type(write(pattern=f'measure = "{rule}"')).value.pattern
    listed = [list(pair) for pair in named.measure]
    assert load_sensor_type(write(pattern=f"measure = {listed}")).value.pattern == named


@pytest.mark.parametrize(
    ("sheet", "said"),
    [
        ("outline_mm = [[0, 0], [1, 0]]", "line 4: sensor_type.outline_mm has 2 corners; at least 3 are needed"),
        (OUTLINE[:-1] + ", [-60, -40]]", "line 4: sensor_type.outline_mm[5] repeats corner 1; the last edge closes"),
        (
            "outline_mm = [[-60, -40], [60, 40], [60, -40], [-60, 40]]",
            "sensor_type.outline_mm crosses itself: the edges after corners 1 and 3 meet",
        ),
        ('outline_mm = [[0, 0], [1, "x"], [3, 4]]', "sensor_type.outline_mm[2][2] is 'x'; it must be a number"),
        ("outline_mm = [[0, 0, 0], [1, 0], [3, 4]]", "sensor_type.outline_mm[1] is [0, 0, 0]; it must have"),
        ("outline_mm = [[0, 0], [nan, 0], [3, 4]]", "sensor_type.outline_mm[2][1] is not a finite number"),
        (OUTLINE + "\nradius_mm = 60.0", "line 5: sensor_type.radius_mm does not apply where outline_mm is given"),
        ("", "sensor_type.radius_mm is missing; a sheet that is no disc needs outline_mm"),
        (OUTLINE + "\ncorner_radius_mm = 50", "sensor_type.corner_radius_mm is 50; the edges leave room for 40 mm"),
        ("radius_mm = 70.0\ncorner_radius_mm = 5", "sensor_type.corner_radius_mm does not apply to a disc"),
    ],
)
def test_an_outline_that_is_none_is_refused_with_its_line(refused, sheet, said):
    assert said in refused(sheet=sheet)


@pytest.mark.parametrize(
    ("electrodes", "said"),
    [
        (PINS.replace("[55, 0]", "[65, 0]"), "electrodes.positions_mm[4] (electrode 3) lies 5 mm outside the sheet"),
        (
            PINS.replace("[55, 0]", "[59.8, 0]"),
            "(electrode 3) lies 0.2 mm from the edge; a pin of 1 mm needs 0.55 mm",
        ),
        (
            PINS.replace("[55, 0]", "[55, 33.9999999]"),
            "(electrode 4) is too close to electrode 3: between centres are 1.0000001 mm, pins of 1 mm need 1.05 mm",
        ),
        (
            PINS.replace("diameter_mm = 1.0", "diameter_mm = 0.01"),
            "electrodes.diameter_mm is 0.01; on this sheet it must",
        ),
        (PINS.replace("[55, 0]", "[55, 34.5]"), "positions_mm[5] (electrode 4) overlaps electrode 3"),
        (
            PINS.replace('"pin"', '"arc"').replace("diameter", "length"),
            "(electrode 0) lies 5 mm from the edge, where its centre must be",
        ),
        (PINS + "\ncount = 8", "electrodes.count does not apply where positions_mm is given"),
        ('kind = "pin"\ndiameter_mm = 1.0', "electrodes.count is missing; without a ring positions_mm is needed"),
        (
            'kind = "arc"\ncount = 8\nring_radius_mm = 40.0\nlength_mm = 2.0',
            "equally spaced arcs need a disc; on another outline give the position of each electrode",
        ),
        (
            'kind = "pin"\ncount = 8\nring_radius_mm = 45.0\ndiameter_mm = 1.0',
            "electrodes.ring_radius_mm does not fit: electrode 2 lies 5 mm outside the sheet",
        ),
        ('kind = "pin"\ndiameter_mm = 1.0\npositions_mm = [[0, 0]]', "must have at least 2 items"),
    ],
)
def test_electrodes_that_do_not_fit_are_refused_with_their_key(refused, electrodes, said):
    assert said in refused(electrodes=electrodes)


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("drive = 5", "pattern.drive is 5; it must be the name of a rule or an array of pairs"),
        ("drive = [[0, 1.5]]", "it must be the name of a rule or an array of pairs"),
        ("measure = [[0, 0]]", "pattern.measure[1] pairs electrode 0 with itself"),
        ("measure = [[0, 8]]", "pattern.measure[1] names electrode 8; allowed: 0 to 7"),
        ("measure = []", "pattern.measure has no pairs"),
        ('measure = "skip-3"', "half of 8 electrodes or more: use 'skip-2' or less, or 'opposite'"),
        ("drive = [[0, 1], [1, 2]]\nmeasure = [[3, 4], [4, 5]]", "pattern never uses electrodes 6, 7"),
        (
            'drive = "opposite"\nmeasure = "opposite"',
            "pattern gives 6 independent readings (12 touch no driven electrode); at least 8 are needed to image",
        ),
    ],
)
def test_a_pattern_that_images_nothing_is_refused_with_its_key(refused, pattern, said):
    assert said in refused(pattern=pattern)


def test_mistakes_of_every_kind_are_listed_together(refused):
    message = refused(
        sheet=OUTLINE + "\ncorner_radius_mm = 99",
        electrodes=PINS + '\ndirection = "clockwise"',
        pattern='drive = "skip-9"',
    )
    assert "3 problems" in message


@pytest.mark.parametrize(
    ("sheet", "said"),
    [
        ("radius_mm = 1e150", "sensor_type.radius_mm is 1e+150; it must be a number from"),
        ("radius_mm = 1e-150", "sensor_type.radius_mm is 1e-150; it must be a number from 0.001"),
        (OUTLINE.replace("[-60, -40]", "[-60, -1e80]"), "is -1e+80; it must be a number from -1"),
        ("outline_mm = [[0, 0], [1e-6, 0], [0, 1e-6]]", "a sheet has at least 0.001 mm"),
    ],
)
def test_sheets_of_no_size_are_refused_by_their_key(refused, sheet, said):
    assert said in refused(sheet=sheet)
