"""Noise of readings and of the load cell: as strong as stated, independent, and addressed."""

import numpy as np
import pytest
from effect_setting import READING_SCALE_V, applied, moment, setting

from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.plan.world import SceneSetting
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa_plugins.effects.force import LoadCellNoise
from cbsr_qa_plugins.effects.readings import MeasurementNoise

SIGNAL = np.linspace(-1, 1, 256).reshape(16, 16)


def _frames(of: SceneSetting, count: int, **parameters: float) -> np.ndarray:
    effect, frames = MeasurementNoise(of, **parameters), []
    for index in range(count):
        frames.append(applied(effect, moment(of, 2.5 * index, index=index), voltages=SIGNAL).voltages - SIGNAL)
    return np.stack(frames)


def test_reading_noise_is_as_strong_as_the_material_says():
    of = setting()
    noise = _frames(of, 400)
    expected = load_material("cbsr-8wt").value.relative_noise.value * READING_SCALE_V
    assert noise.std() == pytest.approx(expected, rel=5 / np.sqrt(2 * noise.size))
    assert abs(noise.mean()) < 5 * expected / np.sqrt(noise.size)


def test_a_frames_noise_is_its_address_in_the_effects_own_stream():
    of = setting(seed=9)
    noise = _frames(of, 4, relative_noise=0.5)[3]
    np.testing.assert_allclose(noise, RandomStream(9, "measurement-noise").normal(3, (16, 16)), rtol=0, atol=1e-15)


def _rms(**parameters: float) -> float:
    """Over the stated scale, from 400 frames."""
    return float(_frames(setting(), 400, **parameters).std()) / READING_SCALE_V


def test_at_the_rigs_integration_time_noise_is_the_stated_number_bit_for_bit():
    of = setting()
    plain = _frames(of, 2, relative_noise=0.013)
    for same in ({"nplc": 0.01}, {"nplc": 1.0, "measured_at_nplc": 1.0}):
        np.testing.assert_array_equal(_frames(of, 2, relative_noise=0.013, **same), plain)
    floored = _frames(of, 2, relative_noise=0.013, relative_floor=0.004)
    np.testing.assert_allclose(floored, plain, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("nplc", [0.001, 0.01, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("floor", [0.0, 0.02, 0.1])
def test_white_noise_falls_with_the_root_of_the_integration_time_down_to_the_floor(nplc: float, floor: float):
    expected = np.sqrt(floor**2 + (0.1**2 - floor**2) * 0.01 / nplc)
    found = _rms(relative_noise=0.1, nplc=nplc, relative_floor=floor)
    assert found == pytest.approx(expected, rel=5 / np.sqrt(2 * 400 * 256))
    assert found > 0.99 * floor


def test_load_cell_noise_is_as_strong_as_stated():
    of = setting()
    effect, forces = LoadCellNoise(of, rms_N=0.03), []
    for index in range(20_000):
        forces.append(applied(effect, moment(of, index / 8, index=index), force_N=2.0).force_N)
    assert np.std(forces) == pytest.approx(0.03, rel=5 / np.sqrt(2 * len(forces)))
    assert np.mean(forces) == pytest.approx(2.0, abs=5 * 0.03 / np.sqrt(len(forces)))
