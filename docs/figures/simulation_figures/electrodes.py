"""Effects on contacts, leads and what drives them."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from cbsr_qa.plugin import Moment, ReadingFlag
from cbsr_qa.report.draw.style import BLUE, CHANGE_MAP, FAINT, QUIET, VERMILION, change_norm
from cbsr_qa.simulate.world import SimulatedWorld
from simulation_figures import worlds
from simulation_figures.look import (
    CLOSED,
    WITHOUT,
    Draw,
    by_electrode,
    frame_map,
    key,
    logarithmic,
    note,
    panels,
    say,
)
from simulation_figures.worlds import Array


def contact_drift() -> Canvas:
    """Contacts over eight hours, and the pairs they belong to."""
    figure, (left, right) = panels(1, 1)
    drift = {"contact-drift": {"deviation_per_hour": 0.3}}
    effect = worlds.effect_factory("contact-drift")(worlds.setting(), deviation_per_hour=0.3)
    made = worlds.world(drift)
    hours = np.linspace(0, 8, 17)
    contacts, ohm = [], []
    for hour in hours:
        at = Moment(made.setting, 3600 * hour, 0, [], [], [], contact_mm=np.full(16, 0.2))
        effect.apply(at)
        contacts.append(at.contact_mm)
        ohm.append(worlds.neighbours_ohm(made, 3600 * hour) / 1e3)
    for axes, values in ((left, np.array(contacts)), (right, np.array(ohm))):
        last = values[-1] / values[0]
        for electrode in range(16):
            ends = {int(last.argmax()): VERMILION, int(last.argmin()): BLUE}
            axes.plot(
                hours,
                values[:, electrode],
                color=ends.get(electrode, FAINT),
                linewidth=0.8,
                zorder=2 + (electrode in ends),
            )
        axes.plot([0, 8], values[0].mean() * np.ones(2), **CLOSED)
    logarithmic(left)
    say(left, "deviation_per_hour = 0.3", "time [h]", "contact over sheet [mm]")
    say(right, "What their pairs show", "time [h]", "between neighbours [kΩ]")
    for axes in (left, right):
        axes.set_xticks(range(0, 9, 2))
    return figure


def temperature_drift() -> Canvas:
    """A reading over four hours."""
    figure, (axes,) = panels(1)
    warming = {"coefficient_per_K": 0.01, "rate_K_per_h": 1.0, "swing_K": 0.5, "period_s": 2400.0}
    made = worlds.world({"temperature-drift": warming})
    hours = np.linspace(0, 4, 97)
    found = np.array([made.frame(3600 * hour, 0).voltages[0, 7] for hour in hours])
    plain = worlds.world({}).frame(0.0, 0).voltages[0, 7]
    warmer = hours + 0.5 * np.sin(2 * np.pi * 3600 * hours / 2400)
    axes.axhline(0, **WITHOUT)
    axes.plot(hours, 100 * (found / plain - 1), "o", color=BLUE, markersize=2.2, label="every reading")
    axes.plot(hours, 100 * (1 / (1 + 0.01 * warmer) - 1), **CLOSED, label="1 / (1 + c ΔT) − 1")
    say(axes, "c = 0.01 /K: 1 K an hour warmer, and ± 0.5 K in 40 minutes", "time [h]", "change of readings [%]")
    note(axes, "without", (4, -0.08), ha="right", va="top", color=QUIET)
    key(axes, "lower left")
    return figure


def lead_resistance() -> Canvas:
    """Where in a frame a bad lead is seen, and when."""
    figure, (left, right) = panels(1.1, 1, height_in=2.2)
    bad = {"electrode": 5, "resistance_ohm": 3000.0, "from_s": 40.0, "to_s": 80.0}
    made, plain = worlds.world({"lead-resistance": bad}), worlds.world({})
    current = made.setting.current_A
    before = plain.frame(0.0, 0).voltages
    change = (made.frame(60.0, 0).voltages - before) / current / 1e3
    frame_map(left, change, "more than without [kΩ]", cmap=CHANGE_MAP, norm=change_norm(3.0))
    left.set_title("3 kΩ in the lead of 5")
    times = np.arange(1.25, 120, 2.5)
    shown = np.array([made.frame(float(at), 0).voltages[5, 5] for at in times]) / current / 1e3
    right.axhline(before[5, 5] / current / 1e3, **WITHOUT)
    right.plot(times, shown, "o", color=BLUE, markersize=2.4)
    say(right, "from_s = 40, to_s = 80", "time [s]", "pair 5 to itself [kΩ]")
    note(right, "without", (60, before[5, 5] / current / 1e3), ha="center", va="bottom", color=QUIET)
    right.margins(y=0.2)
    return figure


def electrode_short() -> Canvas:
    """What a short does to all readings of a frame."""
    figure, (left, right) = panels(1.1, 1, height_in=2.2)
    short = {"electrodes": [3, 9], "resistance_ohm": 100.0}
    made, plain = worlds.world({"electrode-short": short}), worlds.world({})
    current = made.setting.current_A
    before, after = (one.frame(0.0, 0).voltages / current / 1e3 for one in (plain, made))
    limit = float(np.abs(after - before).max())
    frame_map(left, after - before, "more than without [kΩ]", cmap=CHANGE_MAP, norm=change_norm(limit))
    left.set_title("100 Ω between 3 and 9")
    # Between the two: what flows through the short is U/(r + R), so both in parallel are left.
    ohms = np.geomspace(10, 1e6, 13)
    seen = [_between(worlds.world({"electrode-short": {**short, "resistance_ohm": float(r)}})) for r in ohms]
    sheet = _between(plain)
    right.axhline(sheet / 1e3, **WITHOUT)
    logarithmic(right, x=True)
    right.plot(ohms / 1e3, 1e-3 * ohms * sheet / (ohms + sheet), **CLOSED, label="sheet ∥ short")
    right.plot(ohms / 1e3, np.array(seen) / 1e3, "o", color=BLUE, markersize=3, label="simulated")
    note(right, "without", (0.01, 1.08 * sheet / 1e3), va="bottom", color=QUIET)
    right.set_ylim(0.006, 100)
    say(right, "Between the two", "short [kΩ]", "between 3 and 9 [kΩ]")
    key(right, "lower right")
    return figure


def _between(made: SimulatedWorld) -> float:
    """Resistance between electrodes 3 and 9: the sum of what is read along the way while it is driven along it."""
    frame = made.frame(0.0, 0).voltages / made.setting.current_A
    return float(frame[3:9, 3:9].sum())


def source_compliance() -> Canvas:
    """The current of every pair with a broken lead, and of one pair against what it asks for."""
    figure, (left, right) = panels(1, 1)
    broken = {"lead-resistance": {"electrode": 5, "resistance_ohm": 1e5}, "source-compliance": {"limit_V": 20.0}}
    current, limited = _currents(broken)
    bars = np.where(limited, VERMILION, BLUE)
    left.bar(range(16), 1e3 * current, color=bars.tolist(), width=0.7)
    left.bar(0, 0, color=VERMILION, label="flagged")
    left.axhline(0.4, **CLOSED)
    say(left, "100 kΩ in the lead of 5", "", "current [mA]")
    left.set_ylim(0, 0.56)
    by_electrode(left, "drive pair")
    key(left, "upper right")
    plain = float(worlds.neighbours_ohm(worlds.world({}))[5])
    leads = np.geomspace(3e3, 1e6, 9)
    found = []
    for ohm in leads:
        broken["lead-resistance"]["resistance_ohm"] = float(ohm)
        found.append(_currents(broken)[0][5])
    asked = np.geomspace(2e4, 1.1e6, 100)
    logarithmic(right, x=True)
    right.plot(asked / 1e3, 1e3 * np.minimum(4e-4, 20 / asked), **CLOSED, label="min(I, 20 V / R)")
    right.plot((plain + leads) / 1e3, 1e3 * np.array(found), "o", color=BLUE, markersize=3, label="pair 5")
    say(right, "limit_V = 20", "resistance of the pair [kΩ]", "current [mA]")
    key(right, "lower left")
    return figure


def _currents(effects: worlds.Effects) -> tuple[Array, NDArray[np.bool_]]:
    """Current of every drive pair [A], and whether its readings are flagged.

    A frame does not hold the current. A pair far from the bad lead reads in proportion to it, so readings over those
    of a sheet without effects are the current over the nominal one.
    """
    made, plain = worlds.world(effects), worlds.world({})
    frame, before = made.frame(0.0, 0), plain.frame(0.0, 0).voltages
    drives = np.arange(16)
    across = (drives + 8) % 16
    across[(across == 4) | (across == 5)] = 8
    share = frame.voltages[drives, across] / before[drives, across]
    limited: NDArray[np.bool_] = np.all(frame.flags & ReadingFlag.COMPLIANCE, axis=1)
    return share * made.setting.current_A, limited


FIGURES: Final[dict[str, Draw]] = {
    "contact-drift": contact_drift,
    "temperature-drift": temperature_drift,
    "lead-resistance": lead_resistance,
    "electrode-short": electrode_short,
    "source-compliance": source_compliance,
}
