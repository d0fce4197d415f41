"""Elastic stress and its relaxation against Hooke and the generalised Maxwell body."""

from itertools import pairwise

import numpy as np
import pytest
from effect_setting import history, moment, setting
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp

from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.plan.world import SimulatedPress
from cbsr_qa_plugins.effects.force import ElasticStress, StressRelaxation

MATERIAL = load_material("cbsr-8wt").value
E_KPA = 132.5


def _stress_kPa(time_s: float, press: SimulatedPress, *, relaxing: bool = True) -> float:
    of = setting()
    at = moment(of, time_s, press)
    ElasticStress(of).apply(at)
    if relaxing:
        StressRelaxation(of).apply(at)
    return at.stress_kPa[0]


@given(strain=st.floats(0, 0.4), time_s=st.floats(0, 10))
def test_elastic_stress_is_the_modulus_times_the_strain(strain: float, time_s: float):
    press = history((2.0, 3.0, strain))
    expected = E_KPA * strain * min(max((time_s - 2) / 3, 0), 1)
    assert _stress_kPa(time_s, press, relaxing=False) == pytest.approx(expected, abs=1e-12)


def test_any_history_obeys_the_bodys_differential_equation():
    """Each Maxwell branch obeys s′ = E w ε′ − s/τ; the spring beside them carries E ε."""
    press = history((0.0, 1.2, 0.2), (10.0, 3.0, 0.1), (30.0, 1.2, -0.25))
    weights, taus = (
        np.array(values)
        for values in (MATERIAL.stress_relaxation.weights, MATERIAL.stress_relaxation.time_constants_s)
    )

    def slope(time_s: float, branches: np.ndarray) -> np.ndarray:
        rate = sum(s.change / s.ramp_s for s in press.steps if s.start_s <= time_s < s.start_s + s.ramp_s)
        return E_KPA * weights * rate - branches / taus

    corners = [0.0, 1.2, 10.0, 13.0, 30.0, 31.2, 60.0]
    branches = np.zeros(2)
    for start_s, end_s in pairwise(corners):
        # Open at the end, so that no step of the solver straddles a corner.
        solved = solve_ivp(slope, (start_s, end_s - 1e-12), branches, rtol=1e-11, atol=1e-12)
        branches = solved.y[:, -1]
        expected = E_KPA * press.strain_at(end_s) + branches.sum()
        assert _stress_kPa(end_s, press) == pytest.approx(expected, rel=1e-8, abs=1e-8)
