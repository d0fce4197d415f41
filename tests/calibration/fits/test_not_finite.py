"""One NaN or infinity among good numbers: a calculation refuses it by name, and never returns it."""

from dataclasses import replace

import numpy as np
import pytest
from test_hysteresis import _by_hand

from cbsr_qa.calibration.fits import creep_fit as creep, estimates
from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.calibration.fits.hysteresis_fit import hysteresis, loop_curve
from cbsr_qa.calibration.fits.quasi_static import fit_quasi_static
from cbsr_qa.calibration.fits.relaxation import fit_relaxation
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean, relaxation_start
from cbsr_qa.calibration.fits.superposition import fit_step
from cbsr_qa.calibration.strip.relaxation import mean_trace
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.observation import Trace
from cbsr_qa.stats.gauge.reference import straight_line
from cbsr_qa.stats.robust import brunner_munzel
from cbsr_qa.stats.samples import quantile
from cbsr_qa.studies.reproduce.compare import deviations_agree

TIME_S = np.arange(1.0, 61.0)
TRACE = 1 + 0.3 * np.exp(-TIME_S / 5) + 0.1 * np.exp(-TIME_S / 25) + 1e-4 * np.sin(37 * TIME_S)
X = np.linspace(0.05, 0.3, 8)
Y = 2 * X + 1e-3 * np.sin(41 * X)
ERROR = np.full(8, 1e-3)
LOOP = _by_hand(output=lambda k, strain: strain / 0.3 + (0.06 if k == 3 else 0.0))


def trace(values):
    return Trace("change", "1", TIME_S, values)


def spoilt_loop(part, bad, relaxed):
    kept = getattr(LOOP, part)
    middle = LOOP.records[0].held[2]
    values = kept.values.copy()
    values[np.searchsorted(kept.time_s, middle.end_s) - 1] = bad
    loop_curve(replace(LOOP, **{part: replace(kept, values=values)}), relaxed=relaxed, last_s=10.0)


def spoilt_curve(part, bad):
    curve = loop_curve(LOOP, relaxed=False, last_s=10.0)
    hysteresis([curve, replace(curve, **{part: np.full_like(getattr(curve, part), bad)})])


#: What is called, and the good numbers of which one is spoilt.
CALLS = {
    "pooled deviation": (lambda a: estimates.pool_deviations([a, Y]), Y),
    "best line, values": (lambda a: estimates.best_straight_line(X, a), Y),
    "best line, places": (lambda a: estimates.best_straight_line(a, Y), X),
    "best line, errors": (lambda a: estimates.best_straight_line(X, Y, a), ERROR),
    "terminal line, values": (lambda a: estimates.terminal_line(X, a), Y),
    "terminal line, errors": (lambda a: estimates.terminal_line(X, Y, a), ERROR),
    "ratio, parts": (lambda a: estimates.ratio_of_sums(a, X), Y),
    "ratio, wholes": (lambda a: estimates.ratio_of_sums(Y, a), X),
    "spread": (estimates.relative_spread, Y),
    "slope, values": (lambda a: estimates.slope(X, a), Y),
    "slope, places": (lambda a: estimates.slope(a, Y), X),
    "creep between cycles": (lambda a: creep.change_between(zip(Y, a, strict=True)), Y),
    "creep, end": (lambda a: creep.end_level(trace(a), 60), TRACE),
    "creep, level": (lambda a: creep.level_at(trace(a), 4.5), TRACE),
    "relaxation, values": (lambda a: fit_relaxation(TIME_S, a), TRACE),
    "relaxation, times": (lambda a: fit_relaxation(a, TRACE), TIME_S),
    "common relaxation, values": (lambda a: fit_common_relaxation([(TIME_S, a), (TIME_S, TRACE)]), TRACE),
    "common relaxation, times": (lambda a: fit_common_relaxation([(a, TRACE), (TIME_S, TRACE)]), TIME_S),
    "kernel": (lambda a: learn_kernel([(TIME_S, a), (TIME_S, TRACE)], ramp_s=1.0), TRACE),
    "step": (lambda a: fit_step((TIME_S, a), np.array([5.0, 25.0])), TRACE),
    "release": (relaxation_start, TRACE),
    "settling": (lambda a: estimate_restricted_mean(a, [False] * 8), Y),
    "mean trace": (lambda a: mean_trace([(TIME_S, a), (TIME_S, TRACE)]), TRACE),
    "quasi-static, changes": (lambda a: fit_quasi_static(X, X, a, ERROR), Y),
    "quasi-static, places": (lambda a: fit_quasi_static(X, a, Y, ERROR), X),
    "quasi-static, strains": (lambda a: fit_quasi_static(a, X, Y, ERROR), X),
    "quasi-static, errors": (lambda a: fit_quasi_static(X, X, Y, a), ERROR),
    "line, values": (lambda a: straight_line(X, a), Y),
    "line, places": (lambda a: straight_line(a, Y), X),
    "Brunner and Munzel": (lambda a: brunner_munzel(a, Y), Y),
    "quantile": (lambda a: quantile(a, 0.5), Y),
    "agreement": (lambda a: deviations_agree(a[3], 5, 1.0, 5), Y),
}


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("name", CALLS)
def test_a_number_that_is_not_finite_is_refused(name, bad):
    call, good = CALLS[name]
    call(good)  # the others are fine
    spoilt = good.copy()
    spoilt[3] = bad
    with pytest.raises(RefusedError, match="finite"):
        call(spoilt)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("relaxed", [True, False])
@pytest.mark.parametrize("part", ["output", "stress"])
def test_a_loop_with_one_such_value_has_no_hysteresis(part, relaxed, bad):
    with pytest.raises(RefusedError, match=r"is (nan|inf), not a finite number"):
        spoilt_loop(part, bad, relaxed)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("part", ["difference", "stderr"])
def test_places_with_one_such_place_have_no_hysteresis(part, bad):
    with pytest.raises(RefusedError, match=r"is (nan|inf), not a finite number"):
        spoilt_curve(part, bad)
