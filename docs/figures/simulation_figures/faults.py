"""Effects on single electrodes: leads that open, noise of one electrode, and the voltmeter that shows them."""

from itertools import pairwise
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure as Canvas

from cbsr_qa.plugin import Moment, ReadingFlag, SceneSetting
from cbsr_qa.report.draw.style import AMOUNT_MAP, BLUE, QUIET, VERMILION
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

_LIMIT: Final[dict[str, dict[str, Any]]] = {"source-compliance": {"limit_V": 20.0}}


def electrode_open() -> Canvas:
    """What is left of every reading, and the driven pair's own reading in time."""
    figure, (left, right) = panels(1.1, 1, height_in=2.2)
    made = worlds.world({**_LIMIT, "electrode-open": {"electrode": 5, "from_s": 40.0, "to_s": 80.0}})
    before, after = made.frame(0.0, 0).voltages, made.frame(60.0, 0).voltages
    kept = 100 * np.clip(after / before, 0, 1)
    frame_map(left, kept, "left of the reading [%]", cmap=AMOUNT_MAP.reversed(), vmin=0, vmax=100)
    left.set_title("Electrode 5 open")
    times = np.arange(1.25, 120, 2.5)
    frames = [made.frame(float(at), 0) for at in times]
    read = np.array([frame.voltages[5, 5] for frame in frames])
    flagged = np.array([bool(frame.flags[5, 5] & ReadingFlag.COMPLIANCE) for frame in frames])
    right.axhline(20, **CLOSED)
    right.plot(times[~flagged], read[~flagged], "o", color=BLUE, markersize=2.4, label="read")
    right.plot(times[flagged], read[flagged], "o", color=VERMILION, markersize=2.4, label="read, and flagged")
    note(right, "limit_V", (0, 19.7), va="top")
    say(right, "from_s = 40, to_s = 80", "time [s]", "pair 5 on itself [V]")
    right.set_ylim(0, 24)
    key(right, "lower right")
    return figure


def electrode_intermittent() -> Canvas:
    """When the lead is open, and how long it stays so."""
    figure, (left, right) = panels(1.4, 1)
    options = {"electrode": 5, "mean_open_s": 4.0, "mean_closed_s": 16.0}
    made = worlds.world({**_LIMIT, "electrode-intermittent": options})
    times = np.arange(1.25, 240, 2.5)
    flags = [made.frame(float(at), index).flags[5, 5] for index, at in enumerate(times)]
    limited = np.array(flags) & ReadingFlag.COMPLIANCE > 0
    effect = worlds.effect_factory("electrode-intermittent")(made.setting, **options)
    fine_s = np.arange(0.0, 6000.0, 0.2)
    is_open = np.array([_is_open(effect, made.setting, float(at)) for at in fine_s])
    edges = np.flatnonzero(np.diff(is_open.astype(int)))
    spans = [
        (fine_s[begin], fine_s[end] - fine_s[begin])
        for begin, end in pairwise(edges)
        if is_open[end] and fine_s[end] < 240
    ]
    left.broken_barh(spans, (0, 1), color="#c6dbef", linewidth=0, label="lead open")
    left.plot(times, limited, "o", color=BLUE, markersize=2.4, label="pair 5 flagged, frame by frame")
    left.set_yticks([0, 1], ["no", "yes"])
    left.set_ylim(-0.1, 1.5)
    say(left, "Open 4 s, closed 16 s, on average", "time [s]", "", grid="")
    key(left, "upper left", ncols=2)
    lasted = np.diff(edges)[is_open[edges[:-1] + 1]] * 0.2
    along = np.linspace(0, 16, 33)
    right.plot(along, np.exp(-along / 4), **CLOSED, label="e^(−t / 4 s)")
    longer = [(lasted > at).mean() for at in along]
    right.plot(along, longer, "o", color=BLUE, markersize=2.4, label=f"{len(lasted)} in 100 minutes")
    say(right, "How long it stays open", "t [s]", "share open longer")
    key(right, "upper right")
    return figure


def _is_open(effect: Any, of: SceneSetting, time_s: float) -> bool:
    at = Moment(of, time_s, 0, [], [], [], impedance_ohm=np.zeros((16, 16)))
    effect.apply(at)
    assert at.impedance_ohm is not None
    return bool(at.impedance_ohm[5, 5])


def electrode_noise() -> Canvas:
    """The noise of every reading, and of one row."""
    figure, (left, right) = panels(1.1, 1, height_in=2.2)
    noisy = {"measurement-noise": {}, "electrode-noise": {"electrode": 5, "relative_noise": 2e-3}}
    made, plain = worlds.world(noisy), worlds.world({}).frame(0.0, 0).voltages
    frames = np.array([made.frame(0.0, index).voltages - plain for index in range(200)])
    scale = float(np.abs(plain[made.setting.sensor_type.pattern.usable()]).mean())
    rms = 1e3 * frames.std(axis=0) / scale
    frame_map(left, rms, "rms / mean reading [‰]", cmap=AMOUNT_MAP, vmin=0)
    left.set_title("Electrode 5 is noisy")
    own = 1e3 * made.setting.material.relative_noise.value
    stated = np.where(np.isin(range(16), (4, 5)), np.hypot(own, 2.0), own)
    right.step(range(16), stated, where="mid", **CLOSED, label="√(a² + b²)")
    right.plot(range(16), rms[0], "o", color=BLUE, markersize=3.2, label="200 frames")
    say(right, "Drive pair 0", "", "rms / mean reading [‰]")
    right.set_ylim(0, 2.8)
    by_electrode(right, "measure pair")
    key(right, "upper right")
    return figure


def voltmeter_input() -> Canvas:
    """What loading costs on a sheet, and what an open lead shows."""
    figure, (left, right) = panels(1, 1.1)
    plain = worlds.world({}).frame(0.0, 0).voltages
    own_ohm = float(plain[8, 8]) / worlds.setting().current_A
    inputs = np.geomspace(1e6, 1e12, 7)
    lacking = []
    for ohm in inputs:
        read = worlds.world({"voltmeter-input": {"input_ohm": float(ohm)}}).frame(0.0, 0).voltages
        lacking.append(1 - read[0, 8] / plain[0, 8])
    logarithmic(left, x=True)
    left.plot(inputs / 1e6, own_ohm / (own_ohm + inputs), **CLOSED, label="R / (R_in + R)")
    left.plot(inputs / 1e6, lacking, "o", color=BLUE, markersize=3.5, label="simulated")
    left.set_yticks([1e-2, 1e-4, 1e-6, 1e-8], ["1 %", "1e-4", "1e-6", "1e-8"])
    left.set_xticks([1, 1e3, 1e6], ["1 MΩ", "1 GΩ", "1 TΩ"])
    say(left, "A sound sheet: hardly", "input resistance", "lacking of a reading")
    key(left, "upper right")
    broken: dict[str, dict[str, Any]] = {**_LIMIT, "electrode-open": {"electrode": 5}}
    bias = {"input_ohm": 1e7, "bias_A": 1e-9}
    ideal, loaded = (
        1e3 * worlds.world({**broken, **more}).frame(0.0, 0).voltages[12] for more in ({}, {"voltmeter-input": bias})
    )
    used = np.flatnonzero(worlds.sensor_type().pattern.usable()[12])
    right.plot(used, ideal[used], "_", color=QUIET, markersize=8, markeredgewidth=1.2, label="ideal voltmeter")
    right.plot(used, loaded[used], "o", color=BLUE, markersize=3.2, label="10 MΩ, 1 nA")
    right.axhline(10, **CLOSED)
    right.axhline(0, **WITHOUT)
    note(right, "i R_in", (15.6, 12), ha="right", va="bottom")
    say(right, "Electrode 5 open, drive pair 12", "", "reading [mV]")
    right.set_ylim(None, 170)
    by_electrode(right, "measure pair")
    key(right, "upper left")
    return figure


FIGURES: Final[dict[str, Draw]] = {
    "electrode-open": electrode_open,
    "electrode-intermittent": electrode_intermittent,
    "electrode-noise": electrode_noise,
    "voltmeter-input": voltmeter_input,
}
