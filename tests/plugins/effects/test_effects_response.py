"""Piezoresistivity and conductance relaxation against their closed forms."""

import numpy as np
import pytest
from effect_setting import STEP_S, history, kernel, last_outside, moment, setting, with_line
from hypothesis import given, strategies as st
from scipy.integrate import quad

from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.plan.world import Moment, SceneSetting, SimulatedPress
from cbsr_qa.simulate.ramps import CONTACT_STRAIN
from cbsr_qa_plugins.effects.sheet import ConductanceRelaxation, Piezoresistivity

MATERIAL = load_material("cbsr-8wt").value


def _response(of: SceneSetting, time_s: float, *presses: SimulatedPress, relaxed: bool = False) -> list[float]:
    at: Moment = moment(of, time_s, *presses)
    Piezoresistivity(of).apply(at)
    if not relaxed:
        ConductanceRelaxation(of).apply(at)
    return at.response


@given(
    slope=st.floats(-2, 2),
    intercept=st.floats(-0.05, 0.05),
    strains=st.lists(st.floats(0.0, 0.4), min_size=1, max_size=5),
    time_s=st.floats(-1, 30),
)
def test_the_quasi_static_change_is_the_fitted_line_of_the_strain(slope, intercept, strains, time_s):
    changes = np.diff([0.0, *strains])
    press = history(*((5.0 * k, 2.0, float(change)) for k, change in enumerate(changes)))
    strain = press.strain_at(time_s)
    expected = slope * strain + intercept * min(max(strain / CONTACT_STRAIN, 0.0), 1.0)
    (response,) = _response(setting(with_line(slope, intercept)), time_s, press, relaxed=True)
    assert response == pytest.approx(expected, abs=1e-12)


def test_a_release_is_answered_by_the_unloading_kernel_on_top():
    of = setting()
    for after_s in (0.1, 2.0, 36.0):
        held = kernel(MATERIAL.loading_relaxation, 60.0 + after_s)
        lifted = kernel(MATERIAL.unloading_relaxation, after_s)
        press = history((0.0, STEP_S, 0.2), (60.0, STEP_S, -0.2))
        assert _response(of, 60.0 + after_s, press)[0] == pytest.approx(0.12 * (held - lifted), rel=1e-6)


@given(time_s=st.floats(0.01, 200), ramp_s=st.floats(0.05, 40), intercept=st.sampled_from([0.0, 0.02]))
def test_a_ramp_equals_the_hereditary_integral(time_s, ramp_s, intercept):
    of, press = setting(with_line(0.6, intercept)), history((1.0, ramp_s, 0.2))

    def integrand(at_s: float, rate: float) -> float:
        return rate * kernel(MATERIAL.loading_relaxation, time_s - at_s)

    end_s = max(min(time_s, 1.0 + ramp_s), 1.0)
    contact_s = min(1.0 + ramp_s * CONTACT_STRAIN / 0.2, end_s)
    expected = quad(integrand, 1.0, end_s, args=(0.12 / ramp_s,), epsabs=1e-13)[0]
    expected += quad(integrand, 1.0, contact_s, args=(intercept * 0.2 / CONTACT_STRAIN / ramp_s,), epsabs=1e-13)[0]
    assert _response(of, time_s, press)[0] == pytest.approx(expected, rel=1e-8, abs=1e-12)


@given(cut=st.floats(0.01, 0.99), time_s=st.floats(0, 30))
def test_cutting_a_ramp_in_two_changes_nothing(cut, time_s):
    whole = history((0.0, 10.0, 0.2))
    parts = history((0.0, 10.0 * cut, 0.2 * cut), (10.0 * cut, 10.0 * (1 - cut), 0.2 * (1 - cut)))
    of = setting(with_line(0.6, 0.01))
    assert _response(of, time_s, whole)[0] == pytest.approx(_response(of, time_s, parts)[0], rel=1e-10, abs=1e-14)


def test_presses_keep_to_themselves():
    of, one, other = setting(), history((0.0, 1.2, 0.2)), history((20.0, 1.2, 0.1))
    together = _response(of, 40.0, one, other)
    assert together == [*_response(of, 40.0, one), *_response(of, 40.0, other)]


@pytest.mark.parametrize(("name", "loading_s", "unloading_s"), [("cbsr-8wt", 30.0, 36.0), ("cbsr-9wt", 31.0, 38.0)])
def test_the_shipped_materials_settle_as_their_files_say(name, loading_s, unloading_s):
    material = load_material(name).value
    of, steady = setting(material), material.against_strain.slope.value * 0.2
    held, lifted = history((0.0, 1.2, 0.2)), history((-1e4, 1.2, 0.2), (0.0, 1.2, -0.2))
    times = 1.2 + np.arange(0.0, 90.0, 0.05)
    rising = np.array([_response(of, t, held)[0] for t in times]) - steady
    falling = np.array([_response(of, t, lifted)[0] for t in times])
    band = 0.15 * abs(steady)
    # From the end of the ramp; half of its 1.2 s has by then been spent relaxing.
    assert last_outside(times, rising, band) - 1.2 == pytest.approx(loading_s - 0.6, abs=0.2)
    assert last_outside(times, falling, band) - 1.2 == pytest.approx(unloading_s - 0.6, abs=0.2)


@pytest.mark.parametrize("name", ["cbsr-8wt", "cbsr-9wt"])
def test_two_thirds_of_the_change_are_left_two_seconds_after_release(name):
    material = load_material(name).value
    press = history((0.0, 0.3, 0.2), (60.0, 0.3, -0.2))
    before, after = (_response(setting(material), time_s, press)[0] for time_s in (60.0, 62.0))
    assert after / before == pytest.approx(2 / 3, abs=0.03)
