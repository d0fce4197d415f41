"""What a metric may answer, and that a wrong answer is that metric's failure alone."""

import itertools
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from observation_samples import sample_run

from cbsr_qa.analysis.answers import LONGEST_TEXT, MOST_ANSWERS
from cbsr_qa.analysis.evaluate import judge, measure_run
from cbsr_qa.domain.errors import PluginError
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.testing.numerics import check_metric

_GOOD = Measurement("good", 1.0, "mm")
_RUN = sample_run()


class _Metric:
    measures = {"good": "mm", "bad": "mm", "x": "mm"}  # noqa: RUF012

    def __init__(self, answer):
        self._answer = answer

    def measure_run(self, run):
        return self._answer() if callable(self._answer) else self._answer


def _set(**fields):
    one = Measurement("bad", 1.0, "mm")
    for name, value in fields.items():
        object.__setattr__(one, name, value)
    return (one,)


def _half_way():
    yield _GOOD
    raise OSError("half-way")


def _leaving():
    raise SystemExit(0)


class _OwnInterrupt(BaseException):
    def __str__(self):
        raise ValueError("not even a message")


def _odd():
    raise _OwnInterrupt


_WRONG = {
    "text": (_set(value="3"), "value is '3' (str)"),
    "complex": (_set(value=1j), "value is 1j (complex)"),
    "array": (_set(value=np.ones(3)), "value is an array"),
    "0-d array": (_set(value=np.array(1.0)), "value is an array"),
    "Decimal": (_set(value=Decimal("1.5")), "value is a Decimal"),
    "inexact": (_set(value=Fraction(1, 3)), "value is a Fraction"),
    "huge": (_set(value=10**400), "value is "),
    "lossy": (_set(value=2**53 + 1), "value is 9007199254740993 (int)"),
    "bool": (_set(value=True), "value is True (bool)"),
    "numpy's bool": (_set(value=np.True_), "value is a bool"),
    "NaN": (_set(value=float("nan")), "value is nan (float)"),
    "infinite uncertainty": (_set(uncertainty=np.inf), "uncertainty is inf (float)"),
    "NUL": (_set(how="a\0b"), "how is 'a\\x00b' (str)"),
    "control": (_set(location="a\x1b[2J"), "location is "),
    "half a character": (_set(qualifier="\ud800"), "qualifier is "),
    "long text": (_set(how="x" * (LONGEST_TEXT + 1)), "how is "),
    "bytes": (_set(phase=b"p"), "phase is a bytes"),
    "no name": (_set(name=""), "name is "),
    "unit": (_set(unit=None), "unit is None"),
    "trial": (_set(trial=1.5), "trial is 1.5 (float)"),
    "load": (_set(load=2**40), "load is "),
    "bound": (_set(bound="sideways"), "bound is 'sideways' (str)"),
    "judged by itself": (_set(outcome=Outcome.PASS), "outcome is "),
    "nothing": (None, "it returned None (NoneType)"),
    "one alone": (_GOOD, "it returned a Measurement"),
    "no measurement": ((3.0,), "measurement 1 is 3.0 (float)"),
    "raises half-way": (_half_way, "OSError: half-way"),
    "no end": (lambda: itertools.repeat(_GOOD), f"more than {MOST_ANSWERS} measurements"),
    "leaves": (_leaving, "SystemExit: 0"),
    "odd": (_odd, "_OwnInterrupt"),
}


#: Answers that a metric cannot even make.
_UNMADE = {
    "made of a number as unit": (lambda: (Measurement("bad", 1.0, 5),), "measurement bad: unit is 5 (int), not text"),
    "made without a name": (lambda: (Measurement(None, 1.0, "mm"),), "name is None (NoneType), not text"),
    "made of text": (lambda: (Measurement("bad", "3", "mm"),), "measurement bad: value is '3' (str), not a number"),
    "made of an array": (lambda: (Measurement("bad", np.ones(3), "mm"),), "value is an array, not a number"),
}


@pytest.mark.parametrize("case", [*_WRONG, *_UNMADE])
def test_a_wrong_answer_is_that_metrics_failure_and_the_rest_is_judged(case):
    answer, said = (_WRONG | _UNMADE)[case]
    measured, (warning,) = measure_run(_RUN, {"bad-one": _Metric(answer), "fine": _Metric((_GOOD,))})
    assert measured == (_GOOD,)
    assert warning.startswith("metric bad-one failed and measured nothing: ")
    assert said in warning
    judged = judge(measured, [Limit("good", "mm", None, 2.0), Limit("bad", "mm", None, 2.0)])
    assert [one.outcome for one in judged] == [Outcome.PASS, Outcome.NOT_MEASURED]
    assert decide(judged).outcome is Outcome.NOT_MEASURED


@pytest.mark.parametrize("case", [name for name, (_, said) in _WRONG.items() if " is " in said])
def test_the_kit_refuses_what_a_run_refuses(case):
    answer, said = _WRONG[case]
    with pytest.raises(PluginError) as raised:
        check_metric(_Metric(answer), _RUN)
    assert said in raised.value.reason


@pytest.mark.parametrize("value", [3, np.float32(0.1), np.float64(2.5), np.int64(7), np.float64(-0.0)])
def test_numbers_that_a_float_holds_become_floats(value):
    (one,) = check_metric(_Metric(_set(value=value, trial=np.int32(1), name=np.str_("x"))), _RUN)
    assert (type(one.value), one.value) == (float, float(value))
    assert (type(one.trial), type(one.name)) == (int, str)


@pytest.mark.parametrize("stop", [KeyboardInterrupt, GeneratorExit])
def test_the_users_stop_is_no_metrics_failure(stop):
    def stopped():
        raise stop

    with pytest.raises(stop):
        measure_run(_RUN, {"any": _Metric(stopped)})


def test_the_kit_compares_names_and_units():
    metric = _Metric((_GOOD,))
    metric.measures = {"good": "m"}
    with pytest.raises(AssertionError, match="good in mm"):
        check_metric(metric, _RUN)


def test_what_needs_the_force_is_asked_last_and_reported_in_the_order_of_the_recipe():
    asked = []

    class Patient(_Metric):
        needs_force = True

    def answers(name):
        return lambda: asked.append(name) or (Measurement(name, 1.0, "mm"),)

    metrics = {"good": Patient(answers("good")), "x": _Metric(answers("x")), "bad": Patient(answers("bad"))}
    measured, warnings = measure_run(_RUN, metrics)
    assert asked == ["x", "good", "bad"]
    assert [one.name for one in measured] == ["good", "x", "bad"]
    assert not warnings
