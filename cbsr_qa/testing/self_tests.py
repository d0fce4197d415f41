"""Conformance of self-tests: what ``cbsr-qa station check`` prints and stores of a driver."""

from cbsr_qa.domain.station_check import CheckOutcome, CheckResult
from cbsr_qa.interfaces import SelfTesting
from cbsr_qa.testing.instruments import demand
from cbsr_qa.testing.reconstructions import Checked


def check_self_test(instrument: SelfTesting) -> tuple[Checked, ...]:
    """Check a self-test: lines with names of their own, a remedy where one is not well, the same ones a second time.

    Parameters
    ----------
    instrument : open and linked, and well: a driver of which a line fails here cannot be told from one that is wrong.

    Raises
    ------
    AssertionError
        Naming the driver, what it did and what is promised.
    """
    demand(instrument, isinstance(instrument, SelfTesting), "has no self_test")
    first, again = instrument.self_test(), instrument.self_test()
    for found in (first, again):
        demand(instrument, isinstance(found, tuple) and bool(found), f"returns {found!r}, which is no tuple of lines")
        for line in found:
            _check_line(instrument, line)
    names = [line.name for line in first]
    demand(instrument, len(set(names)) == len(names), f"has lines of one name: {', '.join(names)}")
    demand(instrument, names == [line.name for line in again], "has other lines the second time it is asked")
    said = ", ".join(f"{line.name} {line.outcome}" for line in first)
    return (Checked("self-test", said),)


def _check_line(instrument: SelfTesting, line: CheckResult) -> None:
    demand(instrument, isinstance(line, CheckResult), f"has {line!r} among its lines, which is no CheckResult")
    demand(instrument, bool(line.name.strip()), "has a line without a name")
    demand(instrument, line.value is None or bool(line.unit), f"has a value without a unit in its line {line.name!r}")
    helpless = line.outcome in (CheckOutcome.FAILED, CheckOutcome.WARNING) and not line.remedy
    demand(instrument, not helpless, f"says of {line.name!r} that it {line.outcome}, and not what to do about it")
    silent = line.value is None and not line.said and not line.remedy
    demand(instrument, not silent, f"says nothing in its line {line.name!r}: give a value or words")
