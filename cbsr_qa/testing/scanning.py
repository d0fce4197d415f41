"""Conformance of the drivers that frames are scanned with: source-measure units and multiplexers.

Conformance of self-tests: what ``cbsr-qa station check`` prints and stores of a driver.
"""

import math
from typing import Final

from cbsr_qa.domain.run.station import CheckOutcome, CheckResult
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.plugin.instruments import Multiplexer, SelfTesting, SourceMeter
from cbsr_qa.system.clock import Clock
from cbsr_qa.testing.checked import Checked, demand
from cbsr_qa.testing.instruments import check_instrument, safe_state_s

#: For clock ticks and transmission [s].
_TICK_S: Final = 1e-3


def check_source_meter(meter: SourceMeter, clock: Clock, *, current_A: float = 1e-4) -> tuple[Checked, ...]:
    """Check a source-measure unit: it sources the requested current, reports its times, and can be switched off.

    Remedy: set the current before measuring, stamp readings on the context's clock, and switch the output off
    in ``off`` and ``safe_state``.

    Parameters
    ----------
    clock : the one the meter was opened with.
    current_A : requested current; the connected load must take it below the compliance.
    """
    done = check_instrument(meter, SourceMeter)
    for what, value in (("reading takes", meter.reading_period_s), ("compliance is", meter.compliance_V)):
        demand(meter, math.isfinite(value) and value > 0, f"says that its {what} {value!r}")
    volts = []
    for current in (current_A, -current_A, current_A):
        meter.source(current)
        before_s, reading, now_s = clock.now(), meter.measure(), clock.now()
        in_time = before_s - _TICK_S <= reading.time_s <= now_s + _TICK_S
        demand(meter, in_time, f"measured at {reading.time_s:.6g} s when asked from {before_s:.6g} to {now_s:.6g} s")
        demand(meter, not reading.compliance, f"is at its compliance with {current:g} A: connect less resistance")
        gives = abs(reading.current_A - current) <= 0.01 * current_A
        demand(meter, gives, f"gives {reading.current_A:g} A when told {current:g} A")
        volts.append(reading.volts)
        meter.off()
        meter.off()
        safe_state_s(meter)  # runs begin with a safe state
    demand(meter, math.isfinite(sum(volts)), f"measures {volts} V")
    demand(meter, volts[0] * volts[1] <= 0, f"measures {volts[:2]} V at currents of either sign")
    done.append(Checked("readings", f"{volts[0]:.4g} V and {volts[1]:.4g} V at ±{current_A:g} A"))
    return tuple(done)


def check_multiplexer(multiplexer: Multiplexer, pattern: DrivePattern) -> tuple[Checked, ...]:
    """Check a multiplexer: its order holds every combination once, and it can begin again from anywhere.

    Remedy: let ``order`` list every combination of drive and measure pair once, and ``start`` begin from any
    state.
    """
    done = check_instrument(multiplexer, Multiplexer)
    order, (drives, measures) = multiplexer.order(), pattern.shape
    wanted = {(drive, measure) for drive in range(drives) for measure in range(measures)}
    demand(
        multiplexer, set(order) == wanted, f"steps through {len(set(order))} combinations; there are {len(wanted)}"
    )
    demand(multiplexer, len(order) == len(wanted), f"takes {len(order)} steps for {len(wanted)} combinations")
    for steps in (3, len(order) + 1, 0):
        multiplexer.start()
        for _ in range(steps):
            multiplexer.step()
        safe_state_s(multiplexer)
    demand(multiplexer, multiplexer.order() == order, "steps in another order the second time it is asked")
    inner = "measure" if order[0][0] == order[1][0] else "drive"
    done.append(Checked("order", f"{len(order)} combinations, the {inner} pair steps faster"))
    return tuple(done)


def check_self_test(instrument: SelfTesting) -> tuple[Checked, ...]:
    """Check a self-test: lines with names of their own, a remedy where one is not well, the same ones a second time.

    Remedy: return a tuple of ``CheckResult`` with names of their own; give every warning and failure a remedy.

    Parameters
    ----------
    instrument : open, linked and in order: a fault of the instrument would be taken for one of the driver.
    """
    demand(instrument, isinstance(instrument, SelfTesting), "has no self_test")
    first, again = instrument.self_test(), instrument.self_test()
    for lines in (first, again):
        demand(instrument, isinstance(lines, tuple) and bool(lines), f"returns {lines!r}, which is no tuple of lines")
        for line in lines:
            _check_line(instrument, line)
    names = [line.name for line in first]
    demand(instrument, len(set(names)) == len(names), f"has lines of one name: {', '.join(names)}")
    demand(instrument, names == [line.name for line in again], "has other lines the second time it is asked")
    outcomes = ", ".join(f"{line.name} {line.outcome}" for line in first)
    return (Checked("self-test", outcomes),)


def _check_line(instrument: SelfTesting, line: CheckResult) -> None:
    demand(instrument, isinstance(line, CheckResult), f"has {line!r} among its lines, which is no CheckResult")
    demand(instrument, bool(line.name.strip()), "has a line without a name")
    demand(instrument, line.value is None or bool(line.unit), f"has a value without a unit in its line {line.name!r}")
    helpless = line.outcome in (CheckOutcome.FAILED, CheckOutcome.WARNING) and not line.remedy
    demand(instrument, not helpless, f"says of {line.name!r} that it {line.outcome}, and not what to do about it")
    silent = line.value is None and not line.said and not line.remedy
    demand(instrument, not silent, f"says nothing in its line {line.name!r}: give a value or words")
