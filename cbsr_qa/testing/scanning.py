"""Conformance of the drivers that frames are scanned with: source-measure units and multiplexers."""

import math
from typing import Final

from cbsr_qa.clock import Clock
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.interfaces import Multiplexer, SourceMeter
from cbsr_qa.testing.instruments import check_instrument, demand, safe_state_s
from cbsr_qa.testing.reconstructions import Checked

#: Clocks tick, and answers are on their way [s].
_TICK_S: Final = 1e-3


def check_source_meter(meter: SourceMeter, clock: Clock, *, current_A: float = 1e-4) -> tuple[Checked, ...]:
    """Check a source-measure unit: it gives the current it is told, says when it measured, and can be switched off.

    Parameters
    ----------
    clock : the one the meter was opened with.
    current_A : what it is told to give; something must be connected that takes it below the compliance.

    Raises
    ------
    AssertionError
        Naming the driver, what it did and what is promised.
    """
    demand(meter, isinstance(meter, SourceMeter), "is no SourceMeter: it lacks a method or property")
    done = [*check_instrument(meter)]
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

    Raises
    ------
    AssertionError
        Naming the driver, what it did and what is promised.
    """
    demand(multiplexer, isinstance(multiplexer, Multiplexer), "is no Multiplexer: it lacks a method")
    done = [*check_instrument(multiplexer)]
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
