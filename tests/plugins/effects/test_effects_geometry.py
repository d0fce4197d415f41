"""How the sheet lies: a plane, drawn once per seed, as far off as the scene says."""

from dataclasses import replace

import numpy as np
import pytest
from effect_setting import applied, moment, setting

from cbsr_qa_plugins.effects.head import SheetSeat

ERROR_MM = 0.05
SETTING = setting()


def surface_mm(seat: SheetSeat, x_mm: float, y_mm: float, time_s: float = 0.0, index: int = 0) -> float:
    return applied(seat, moment(SETTING, time_s, index=index), place_mm=(x_mm, y_mm)).surface_mm


def seats(count: int) -> list[SheetSeat]:
    return [SheetSeat(replace(SETTING, seed=seed), error_mm=ERROR_MM) for seed in range(count)]


def test_the_sheet_is_a_plane_that_does_not_move():
    seat = SheetSeat(SETTING, error_mm=ERROR_MM)
    places = np.random.default_rng(0).uniform(-35, 35, (30, 2))
    heights = np.array([surface_mm(seat, x, y) for x, y in places])
    system = np.column_stack([np.ones(30), places])
    plane, *_ = np.linalg.lstsq(system, heights)
    np.testing.assert_allclose(system @ plane, heights, rtol=0, atol=1e-15)
    assert np.ptp(heights) > 0
    assert surface_mm(seat, 3.0, 4.0) == surface_mm(seat, 3.0, 4.0, time_s=500.0, index=77)


def test_level_and_tilt_spread_as_the_scene_says():
    drawn = seats(2000)
    centre = np.array([surface_mm(seat, 0.0, 0.0) for seat in drawn])
    along_x, along_y = (
        np.array([surface_mm(seat, *edge) for seat in drawn]) - centre for edge in ((50.0, 0.0), (0.0, 50.0))
    )
    for part in (centre, along_x, along_y):
        assert part.std() == pytest.approx(ERROR_MM, rel=0.08)  # five standard errors of 2000 draws
        assert abs(part.mean()) < 5 * ERROR_MM / np.sqrt(len(drawn))
    together = np.corrcoef([centre, along_x, along_y])
    assert np.abs(together - np.eye(3)).max() < 5 / np.sqrt(len(drawn))


def test_a_seat_adds_to_what_other_effects_did():
    seat = SheetSeat(SETTING, error_mm=ERROR_MM)
    lowered = applied(seat, moment(SETTING, 0.0), surface_mm=1.0)
    assert lowered.surface_mm == pytest.approx(1.0 + surface_mm(seat, 0.0, 0.0), abs=1e-15)


def test_no_error_is_an_exactly_flat_sheet():
    assert surface_mm(SheetSeat(SETTING, error_mm=0.0), 30.0, -10.0) == 0.0
