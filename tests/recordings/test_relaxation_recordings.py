"""Relaxations of real sheets: no second exponential is claimed where the data carry none."""

from pathlib import Path

import numpy as np
import pytest

from cbsr_qa.calibrate.relaxation import fit_relaxation
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.domain.recording import ReadOptions
from cbsr_qa.domain.relaxation import FitStatus
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
