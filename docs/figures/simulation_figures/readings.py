"""Effects on when readings are taken and on what is read."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure as Canvas
from scipy.constants import Boltzmann, zero_Celsius

from cbsr_qa.plugin import Moment, ReadingFlag
from cbsr_qa.report.draw.style import AMOUNT_MAP, BLUE, GREEN, QUIET, VERMILION
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
from simulation_figures.worlds import Array, press


def time_skew() -> Canvas:
    """When each reading is taken, and what a fast press does to one frame."""
    figure, (left, right) = panels(1, 1.25, height_in=2.2)
    ramp = press((-0.5, 0.8, 0.2))
    made = worlds.world({"time-skew": {}, "piezoresistivity": {}}, ramp)
    still = worlds.world({"piezoresistivity": {}}, ramp)
    frame = made.frame(0.0, 0)
    assert frame.time_s is not None
    frame_map(left, frame.time_s, "taken at [s]", cmap=AMOUNT_MAP)
    left.set_title('inner = "measure": row by row')
    used = made.setting.sensor_type.pattern.usable()
    before, middle, after = (still.frame(at, 0).voltages for at in (-5.0, 0.0, 5.0))
    # Readings that hardly feel a press in the middle say little about when they were taken.
    told = used & (np.abs(after - before) > 0.4 * np.abs(after - before)[used].max())
    in_turn, at_once = (((taken - before) / (after - before))[told] for taken in (frame.voltages, middle))
    right.axhline(100 * at_once.mean(), **WITHOUT, label="without: all at 0 s")
    right.plot(frame.time_s[told], 100 * in_turn, "o", color=BLUE, markersize=2, label="in turn")
    right.plot([-1.25, -0.5, 0.3, 1.25], [0, 0, 100, 100], **CLOSED, label="strain")
    say(right, "A press within one frame", "time of the reading [s]", "share of its change [%]")
    key(right, "upper left")
    return figure


def measurement_noise() -> Canvas:
    """Noise of all readings of some frames, and how it falls with the integration time."""
    figure, (left, right) = panels(1, 1.1)
    plain = worlds.world({}).frame(0.0, 0).voltages
    mean = float(np.abs(plain[worlds.sensor_type().pattern.usable()]).mean())
    noise = 1e3 * _noise({"measurement-noise": {}}, plain, 40).ravel() / mean
    rms = 1e3 * worlds.material().relative_noise.value
    edges = np.linspace(-4, 4, 41) * rms
    left.hist(noise, edges.tolist(), density=True, color=BLUE, label="40 frames")
    along = np.linspace(-4, 4, 161) * rms
    left.plot(along, np.exp(-((along / rms) ** 2) / 2) / rms / np.sqrt(2 * np.pi), **CLOSED, label="Gaussian")
    say(left, "8 wt%: rms 7.9e-4", "noise / mean reading [‰]", "density")
    left.set_ylim(0, 0.68)
    key(left, "upper left")
    cycles = np.geomspace(0.001, 25, 9)
    within = np.geomspace(0.001, 25, 60)
    logarithmic(right, x=True)
    for floor, colour in ((0.0, BLUE), (1e-4, GREEN)):
        options = ({"nplc": float(nplc), "relative_floor": floor} for nplc in cycles)
        found = [_noise({"measurement-noise": option}, plain, 10).std() / mean for option in options]
        right.plot(within, 1e3 * np.hypot(floor, np.sqrt((7.9e-4**2 - floor**2) * 0.01 / within)), **CLOSED)
        right.plot(
            cycles, 1e3 * np.array(found), "o", color=colour, markersize=3.5, label=f"relative_floor = {floor:g}"
        )
    say(right, "Longer readings", "integration [NPLC]", "rms / mean reading [‰]")
    key(right, "lower left")
    return figure


def _noise(effects: worlds.Effects, plain: Array, frames: int) -> Array:
    made = worlds.world(effects)
    return np.array([made.frame(0.0, index).voltages - plain for index in range(frames)])


def johnson_noise() -> Canvas:
    """Noise of pairs of very different resistance, at two integration times."""
    figure, (axes,) = panels(1)
    uneven = {"contact-spread": {"deviation": 3.0, "contact_mm": 3.0}}
    plain = worlds.world(uneven)
    still = plain.frame(0.0, 0).voltages
    ohm = np.diag(still) / plain.setting.current_A
    along = np.linspace(0, 1.05 * np.sqrt(ohm.max()), 60) ** 2
    for nplc, colour in ((0.01, BLUE), (1.0, GREEN)):
        made = worlds.world({**uneven, "johnson-noise": {"nplc": nplc}})
        noise = np.array([made.frame(0.0, index).voltages - still for index in range(100)])
        nyquist = np.sqrt(4 * Boltzmann * (zero_Celsius + 23) * along * 50 / (2 * nplc))
        axes.plot(along / 1e3, 1e6 * nyquist, **CLOSED)
        rms = 1e6 * noise.std(axis=(0, 1))
        axes.plot(ohm / 1e3, rms, "o", color=colour, markersize=3.5, label=f"nplc = {nplc:g}")
    axes.plot([], [], **CLOSED, label="√(4 k T R / 2 T_int)")
    say(axes, "Thermal noise of 16 measured pairs, 1600 readings each", "resistance of the pair [kΩ]", "rms [µV]")
    key(axes, "center right")
    return figure


def mains_hum() -> Canvas:
    """What integration lets through."""
    figure, (axes,) = panels(1)
    plain = worlds.world({"time-skew": {}}).frame(0.0, 0).voltages
    cycles = np.array([0.01, 0.1, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0])
    left = []
    for nplc in cycles:
        hum = {"amplitude_V": 0.01, "nplc": float(nplc)}
        heard = worlds.world({"time-skew": {}, "mains-hum": hum}).frame(0.0, 0).voltages - plain
        left.append(np.sqrt(2) * heard.std())
    along = np.linspace(0, 3.1, 400)
    axes.plot(along, 10 * np.abs(np.sinc(along)), **CLOSED, label="A |sinc(NPLC)|")
    axes.plot(cycles, 1e3 * np.array(left), "o", color=BLUE, markersize=4, label="√2 × deviation of 256 readings")
    note(axes, "the rig: 0.01", (0.01, 9.7), xytext=(0.02, 5), arrowprops={"arrowstyle": "-", "linewidth": 0.5})
    say(axes, "A hum of 10 mV: whole cycles let nothing through", "integration [NPLC]", "hum left [mV]")
    axes.set_ylim(0, 11)
    key(axes, "upper right")
    return figure


def reading_memory() -> Canvas:
    """A row of readings before and after."""
    figure, (left, right) = panels(1.5, 1)
    plain = worlds.world({}).frame(0.0, 0).voltages
    mixed = worlds.world({"reading-memory": {"share": 0.13}}).frame(0.0, 0).voltages
    left.plot(range(16), plain[5], "_", color=QUIET, markersize=9, markeredgewidth=1.2, label="without")
    left.plot(range(16), mixed[5], "o", color=BLUE, markersize=3.2, label="share = 0.13")
    before = np.roll(mixed, 1)[5]
    left.plot(range(16), 0.87 * plain[5] + 0.13 * before, "+", color=VERMILION, markersize=6, label="the recursion")
    say(left, "Drive pair 5: what is driven smears", "", "reading [V]")
    by_electrode(left, "measure pair")
    key(left, "upper right")
    used = np.flatnonzero(worlds.sensor_type().pattern.usable()[5])
    right.axhline(0, **WITHOUT)
    right.bar(used, 1e3 * (mixed - plain)[5, used], color=BLUE, width=0.7)
    say(right, "Error of used readings", "", "after − before [mV]")
    by_electrode(right, "measure pair")
    return figure


def reading_offset() -> Canvas:
    """A row, and the way round."""
    figure, (left, right) = panels(1, 1)
    plain = worlds.world({}).frame(0.0, 0).voltages
    off = worlds.world({"reading-offset": {"offset_V": 0.05}}).frame(0.0, 0).voltages
    used = np.arange(2, 15)
    left.plot(used, plain[0, used], "_", color=QUIET, markersize=9, markeredgewidth=1.2, label="without")
    left.plot(used, off[0, used], "o", color=BLUE, markersize=3.2, label="offset_V = 0.05")
    say(left, "Drive pair 0, used readings", "", "reading [V]")
    by_electrode(left, "measure pair")
    key(left, "lower center")
    right.axhline(0.8, **CLOSED, label="16 × offset")
    right.plot(range(16), off.sum(axis=1), "o", color=BLUE, markersize=3.2, label="with")
    right.plot(range(16), plain.sum(axis=1), "_", color=QUIET, markersize=9, markeredgewidth=1.2, label="without")
    say(right, "Once round the sheet", "", "sum of the row [V]")
    right.set_ylim(-0.1, 1.3)
    by_electrode(right, "drive pair")
    key(right, "upper left", ncols=3, columnspacing=1.0, handletextpad=0.4)
    return figure


def quantisation() -> Canvas:
    """A staircase and its error."""
    figure, (left, right) = panels(1, 1)
    true = np.linspace(-0.1, 0.1, 256)
    step = 2 * 2.0 / 2**8
    read = _read("quantisation", true, range_V=2.0, bits=8)
    left.plot(1e3 * true, 1e3 * true, **CLOSED, label="without")
    left.plot(1e3 * true, 1e3 * read, color=BLUE, label="bits = 8, range_V = 2")
    say(left, f"Steps of {1e3 * step:.1f} mV", "voltage [mV]", "reading [mV]")
    left.set_ylim(-110, 165)
    key(left, "upper left")
    right.plot(1e3 * true, 1e3 * (read - true), color=BLUE)
    for half in (-1, 1):
        right.axhline(half * 1e3 * step / 2, **CLOSED)
    note(right, "± half a step", (0, 1e3 * step / 2), ha="center", va="bottom")
    right.set_ylim(-11, 11)
    say(right, "Error", "voltage [mV]", "reading − voltage [mV]")
    return figure


def converter_saturation() -> Canvas:
    """All readings of a frame, by size."""
    figure, (axes,) = panels(1)
    plain = np.sort(worlds.world({}).frame(0.0, 0).voltages.ravel())
    made = worlds.world({"converter-saturation": {"range_V": 2.0}}).frame(0.0, 0)
    order = np.argsort(made.voltages.ravel(), kind="stable")
    read, flags = made.voltages.ravel()[order], made.flags.ravel()[order]
    ends = (flags & ReadingFlag.SATURATED) > 0
    axes.plot(range(256), plain, **WITHOUT, label="without")
    axes.plot(range(256), np.where(ends, np.nan, read), color=BLUE, linewidth=2.2, label="read")
    axes.plot(range(256), np.where(ends, read, np.nan), color=VERMILION, linewidth=2.2, label="read, and flagged")
    for end in (-2, 2):
        axes.axhline(end, **CLOSED)
    say(axes, "range_V = 2: readings of driven pairs and their neighbours end", "reading, by size", "voltage [V]")
    axes.set_yscale("symlog", linthresh=0.1)
    axes.set_yticks([-2, -0.1, 0, 0.1, 2], ["−2", "−0.1", "0", "0.1", "2"])
    key(axes, "center")
    return figure


def _read(name: str, voltages: Array, **options: float) -> Array:
    """What an effect makes of a frame of these voltages."""
    of = worlds.setting()
    shape = of.sensor_type.pattern.shape
    flags = np.zeros(shape, dtype=np.uint8)
    at = Moment(of, 0.0, 0, [], [], [], voltages=voltages.reshape(shape), flags=flags)
    worlds.effect_factory(name)(of, **options).apply(at)
    assert at.voltages is not None
    return at.voltages.ravel()


FIGURES: Final[dict[str, Draw]] = {
    "time-skew": time_skew,
    "measurement-noise": measurement_noise,
    "johnson-noise": johnson_noise,
    "mains-hum": mains_hum,
    "reading-memory": reading_memory,
    "reading-offset": reading_offset,
    "quantisation": quantisation,
    "converter-saturation": converter_saturation,
}
