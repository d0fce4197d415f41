"""A fixed sample of the faults that ``make faults`` strikes with: the same checks, one run a fault."""

import pytest
from campaign import matrix
from judgement import allowed_s
from short_run import TWO_PLACES, steps_of_a_run
from trial import OF_INSTRUMENTS, OF_THE_COMPUTER, run_with

#: One of every fault, at a step that differs from fault to fault and is of every kind for some of them.
STEPS = len(steps_of_a_run(TWO_PLACES))
SAMPLE = tuple(matrix(STEPS, every=STEPS))


@pytest.mark.rest
def test_a_run_without_a_fault_finishes_and_comes_to_rest():
    outcome = run_with(None, TWO_PLACES)
    assert outcome.kind == "rode through", outcome
    assert outcome.wrong == []


@pytest.mark.rest
@pytest.mark.parametrize("injected", SAMPLE, ids=lambda one: f"{one.role}-{one.fault}-{one.step}".replace(" ", "-"))
def test_a_fault_ends_in_rest_and_a_record(injected):
    outcome = run_with(injected, TWO_PLACES)
    assert outcome.wrong == [], outcome
    assert outcome.safe_after_s <= allowed_s()


def test_the_sample_has_every_fault_once():
    known = {**OF_INSTRUMENTS, **OF_THE_COMPUTER}
    assert [(one.role, one.fault) for one in SAMPLE] == [(role, f) for role, faults in known.items() for f in faults]
