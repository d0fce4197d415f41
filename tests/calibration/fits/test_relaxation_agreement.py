"""Equivalence of two relaxations: what is claimed of equal, unequal and badly known ones, and how often wrongly."""

import numpy as np
import pytest
from simulated_runs import observed_run, simulated_run
from test_relaxation_common import TIME_S, _traces

from cbsr_qa.calibration.fits.agreement import Agreement, MeasuredRelaxation, compare_relaxations
from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa_plugins.metrics.relaxation import BlobAndImageRelaxation

_WINDOW_S = float(TIME_S[-1])


def _measured(noise, seed, *, loads=9, amplitudes=(-0.20, -0.55), taus=(2.5, 23.1), size=1.0, **options):
    traces = _traces([size] * loads, noise, seed, amplitudes=amplitudes, taus=taus, **options)
    return MeasuredRelaxation(fit_common_relaxation(traces), _WINDOW_S, start_s=float(TIME_S[0]))


def test_the_same_relaxation_in_other_units_is_equivalent():
    found = compare_relaxations(_measured(0.005, 1), _measured(5.0, 2, size=1000.0))
    assert found.shape is found.time is Agreement.EQUIVALENT
    assert found.time_ratio == pytest.approx(1.0, abs=3 * found.time_ratio_stderr)
    assert found.shape_reach < 0.1
    assert not found.why


def test_what_relaxes_twice_as_slowly_or_half_as_much_is_different():
    slow = compare_relaxations(_measured(0.003, 1), _measured(0.003, 2, taus=(2.5, 12.0)))
    assert slow.shape is slow.time is Agreement.DIFFERENT
    assert slow.time_ratio == pytest.approx(12.0 / 23.1, rel=0.1)
    less = compare_relaxations(_measured(0.003, 1), _measured(0.003, 2, amplitudes=(-0.1, -0.25)))
    assert less.shape is Agreement.DIFFERENT
    assert less.shape_difference > 0


def test_noise_is_no_proof_of_equivalence():
    found = compare_relaxations(_measured(0.2, 1, loads=4), _measured(0.2, 2, loads=4))
    assert found.shape is Agreement.UNDECIDED
    assert found.time is not Agreement.EQUIVALENT


@pytest.mark.rest
def test_a_margin_apart_is_rarely_called_equivalent_or_different():
    """Amplitudes scaled so that the curves differ by exactly 0.1 at 1.25 s, where they do so most."""
    start = -(0.20 * np.exp(-TIME_S[0] / 2.5) + 0.55 * np.exp(-TIME_S[0] / 23.1))
    factor = 1 + 0.1 / start
    apart = (-0.20 * factor, -0.55 * factor)
    found = [
        compare_relaxations(_measured(0.01, seed), _measured(0.01, 1000 + seed, amplitudes=apart)).shape
        for seed in range(40)
    ]
    assert found.count(Agreement.EQUIVALENT) <= 5
    assert found.count(Agreement.DIFFERENT) <= 2


def test_unloadings_are_compared_by_what_was_released():
    def released(seed, size):
        traces = _traces([size] * 9, 0.004 * size, seed, amplitudes=(0.2, 0.62), taus=(2.5, 15.0), offset=0.02)
        return MeasuredRelaxation(fit_common_relaxation(traces), _WINDOW_S, loaded_change=size)

    found = compare_relaxations(released(1, 1.0), released(2, 40.0))
    assert found.shape is found.time is Agreement.EQUIVALENT


@pytest.mark.parametrize(
    ("traces", "why"),
    [
        ([(TIME_S, 0.01 * k * TIME_S) for k in (1, 2, 3)], "no curve: still drifting"),
        ([(TIME_S, np.random.default_rng(k).normal(0, 1, TIME_S.size)) for k in range(4)], "clear of zero"),
    ],
)
def test_what_cannot_be_compared_is_undecided_and_says_why(traces, why):
    found = compare_relaxations(_measured(0.01, 1), MeasuredRelaxation(fit_common_relaxation(traces), _WINDOW_S))
    assert found.shape is found.time is Agreement.UNDECIDED
    assert found.shape_difference is found.time_ratio is None
    assert why in found.why


@pytest.mark.rest
def test_runs_compare_blobs_with_the_whole_image():
    run = observed_run(simulated_run(NINE_LOCATIONS_MM, noise=5e-5))
    found = {(m.name, m.qualifier): m for m in BlobAndImageRelaxation().measure_run(run)}
    assert len(found) == 4
    loading = found["relaxation_shape_difference", "image against conductance, loading"]
    assert abs(loading.value) < 0.05
    assert found["relaxation_time_ratio", "image against conductance, loading"].value == pytest.approx(1.0, abs=0.1)
    assert {m.unit for m in found.values()} == {"1"}
    assert all(m.uncertainty > 0 for m in found.values() if m.value is not None)
