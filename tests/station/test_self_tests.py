"""Self-tests of every driver of the emulated bench conform, and the kit tells one that does not."""

import pytest

from cbsr_qa.domain.run.station import CheckOutcome, CheckResult
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.instruments import SelfTesting
from cbsr_qa.station.setup import configure, open_station, station_clock
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, ScriptedInstrument
from cbsr_qa.testing.scanning import check_self_test

OK, FAILED = CheckOutcome.OK, CheckOutcome.FAILED


def test_those_of_all_built_in_drivers_conform():
    configuration = configure("bench-emulated", "golden-check", sensor_type=None, material=None, seed=1)
    bench = open_station(configuration, discover(), station_clock(configuration))
    try:
        testing = {one.spec.role: one.instrument for one in bench.mounted if isinstance(one.instrument, SelfTesting)}
        assert {"frames", "load_cell", "multiplexer", "source_meter"} <= set(testing)
        for role, instrument in testing.items():
            (done,) = check_self_test(instrument)
            assert " ok" in done.found, role
    finally:
        bench.safe_state()
        bench.close()


class SelfTested(ScriptedInstrument):
    """An instrument whose self-tests were written down."""

    def __init__(self, *answers):
        super().__init__("cell", Script(VirtualClock()))
        self.answers = list(answers)

    def self_test(self):
        return self.answers.pop(0)


WELL = (CheckResult("zero", OK, 0.1, "N"), CheckResult("noise", OK, said="none"))


def test_one_that_keeps_its_promises_is_told_with_its_lines():
    (done,) = check_self_test(SelfTested(WELL, WELL))
    assert done.found == "zero ok, noise ok"


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        (([], []), "is no tuple of lines"),
        (((), ()), "is no tuple of lines"),
        ((("fine",), ("fine",)), "is no CheckResult"),
        ((WELL, WELL[:1]), "has other lines the second time"),
        ((WELL[:1] * 2, WELL[:1] * 2), "has lines of one name: zero, zero"),
        (((CheckResult(" ", OK, said="x"),), WELL), "a line without a name"),
        (((CheckResult("zero", OK, 0.1),), WELL), "a value without a unit in its line 'zero'"),
        (((CheckResult("zero", FAILED, 0.9, "N"),), WELL), "says of 'zero' that it failed, and not what to do"),
        (((CheckResult("zero", OK),), WELL), "says nothing in its line 'zero'"),
    ],
)
def test_one_that_breaks_a_promise_is_told_which(answers, said):
    with pytest.raises(AssertionError, match=said) as broken:
        check_self_test(SelfTested(*answers))
    assert str(broken.value).startswith("SelfTested ")


def test_an_instrument_without_one_is_told_so():
    with pytest.raises(AssertionError, match="has no self_test"):
        check_self_test(ScriptedInstrument("cell", Script(VirtualClock())))
