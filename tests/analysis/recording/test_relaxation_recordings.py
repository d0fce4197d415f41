"""Relaxations of real sheets: no second exponential is claimed where the data carry none."""

from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.calibration.fits.relaxation import fit_relaxation
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.steady_state import interval, predict_steady
from cbsr_qa.domain.readings.frames import ReadOptions
from cbsr_qa.domain.results.relaxation import FitStatus
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv

pytestmark = pytest.mark.shared


def _frames(shared: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    frames = ErtBoardCsv().read(shared / "data" / "black_sensor" / name, ReadOptions()).frames
    return frames.time_s - frames.time_s[0], frames.voltages


def test_the_centre_press_of_the_150_mm_sheet_rises_within_about_two_seconds(shared: Path):
    time_s, voltages = _frames(shared, "expABCX_150mm_8.5wt_6.csv")
    used = adjacent_pattern(16).usable()
    rest = voltages[:8].mean(axis=0)
    rise = ((voltages - rest)[:, used] * np.sign(rest[used])).mean(axis=1)
    held = (time_s >= 8.0) & (time_s < 17.3)
    fit = fit_relaxation(time_s[held] - 8.0, rise[held])
    assert fit.status is FitStatus.ONE
    assert fit.time_constants_s[0] == pytest.approx(2.0, abs=0.7)
    assert fit.time_constant_stderr_s[0] < 0.6


@pytest.mark.parametrize("pair", [0, 13, 14, 15])
def test_driven_pairs_of_the_100_mm_sheet_carry_no_second_exponential(shared: Path, pair: int):
    time_s, voltages = _frames(shared, "expABX_100mm_9.5wt_6.csv")
    held = time_s >= 14.6
    fit = fit_relaxation(time_s[held] - 14.6, voltages[held, pair, pair], r_squared_gate=0.0)
    assert fit.status is not FitStatus.TWO
    assert fit.why


_PAIRS = (0, 14, 15)


def _driven_pairs(shared: Path) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Changes of three driven pairs from their peak on: the second of two pushes ends there, at 16.9 s."""
    time_s, voltages = _frames(shared, "expABX_100mm_9.5wt_6.csv")
    readings = voltages[:, _PAIRS, _PAIRS]
    peak = int(np.argmin(readings.mean(axis=1)))
    assert time_s[peak] == pytest.approx(16.9, abs=0.3)
    change = readings[peak:] - np.median(readings[time_s < 6.0], axis=0)
    return {pair: (time_s[peak:] - time_s[peak], change[:, column]) for column, pair in enumerate(_PAIRS)}


def test_driven_pairs_relax_in_seven_to_eight_and_a_half_seconds(shared: Path):
    traces = _driven_pairs(shared)
    for trace in traces.values():
        fit = fit_relaxation(*trace, r_squared_gate=0.0)
        assert fit.status is FitStatus.ONE
        assert 7.0 <= fit.time_constants_s[0] <= 8.5
    together = fit_common_relaxation(list(traces.values())).fit
    assert together.status is FitStatus.ONE
    assert 7.0 <= together.time_constants_s[0] <= 8.5
    assert together.time_constant_stderr_s[0] < 1.0


@pytest.mark.parametrize("pair", _PAIRS)
@pytest.mark.parametrize("seen_s", [3.0, 5.0])
def test_where_a_pair_ends_is_predicted_from_the_others_relaxation(shared: Path, pair: int, seen_s: float):
    traces = _driven_pairs(shared)
    time_s, change = traces.pop(pair)
    end = change[-30:].mean()
    noise = float(np.diff(change[-60:]).std() / np.sqrt(2))
    short = time_s < seen_s
    kernel = learn_kernel(list(traces.values()))
    found = predict_steady(time_s[short], change[short], noise, kernel)
    low, high = interval(found, 0.95)
    assert low[0] < end < high[0]
    last = change[short][-5:].mean()
    assert abs(found.values[0] - end) < 0.8 * abs(last - end)
