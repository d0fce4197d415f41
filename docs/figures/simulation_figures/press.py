"""Effects on what a press does: change of conductance, stress and force."""

from dataclasses import replace
from typing import Final

import numpy as np
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic
from cbsr_qa.plugin import Indenter, Moment
from cbsr_qa.report.draw.style import BLUE, QUIET, VERMILION
from simulation_figures import worlds
from simulation_figures.look import CLOSED, WITHOUT, Draw, key, note, panels, say
from simulation_figures.worlds import RAMP_S, Array, press

#: 20 % strain, held for a minute.
_HOLD: Final = ((0.0, RAMP_S, 0.2), (60.0 + RAMP_S, RAMP_S, -0.2))
_QUASI_STATIC: Final[worlds.Effects] = {"piezoresistivity": {}}
_CREEPING: Final[worlds.Effects] = {"piezoresistivity": {}, "conductance-relaxation": {}}


def piezoresistivity() -> Canvas:
    """The change against strain for both materials, and how an intercept fades in."""
    figure, (left, right) = panels(1, 1)
    strains = np.arange(0.05, 0.31, 0.05)
    along = np.linspace(0, 0.32, 20)
    for name, colour in (("cbsr-8wt", BLUE), ("cbsr-9wt", VERMILION)):
        of = worlds.material(name)
        line = of.against_strain
        made = worlds.world(_QUASI_STATIC, of=of)
        found = []
        for strain in strains:
            made.presses[:] = [press((0.0, RAMP_S, float(strain)))]
            found.append(made.truth(60.0)[0].relative_change)
        left.plot(100 * along, 100 * line.slope.value * along, **CLOSED)
        left.plot(100 * strains, 100 * np.array(found), "o", color=colour, markersize=3.5, label=name)
    say(left, "Both materials: a line", "strain [%]", "change Δρ/ρ₀ [%]")
    key(left, "upper left")
    line = QuasiStatic(Parameter(0.6, None, "figure"), Parameter(0.01, None, "figure"))
    made = worlds.world(_QUASI_STATIC, press((0.0, 4.0, 0.04)), of=replace(worlds.material(), against_strain=line))
    times = np.linspace(0, 4, 81)
    right.plot(times, 100 * (0.6 * times / 100 + 0.01), **CLOSED, label="α ε + β")
    right.plot(times, 100 * worlds.change_of(made, times), color=BLUE, label="simulated")
    right.axvline(1.25, color=QUIET, linewidth=0.6, linestyle=":")
    note(right, "1.25 %", (1.3, 0.1), va="bottom")
    right.set_ylim(0, 3.8)
    say(right, "β = 0.01 fades in with contact", "strain [%]", "change Δρ/ρ₀ [%]")
    key(right, "upper left")
    return figure


def conductance_relaxation() -> Canvas:
    """A press held for a minute."""
    figure, (axes,) = panels(1)
    times = np.concatenate([np.linspace(-5, 66, 200), np.linspace(66, 150, 100)])
    axes.plot(times, _percent(_QUASI_STATIC, times), **WITHOUT, label="piezoresistivity alone")
    axes.plot(times, _percent(_CREEPING, times), color=BLUE, label="with conductance-relaxation")
    loads, lifts = worlds.material().loading_relaxation, worlds.material().unloading_relaxation
    held = 12 * (1 + _sum(loads.weights, loads.time_constants_s, times[times > RAMP_S] - RAMP_S / 2))
    after = times[times > 66]
    left = 12 * (1 + _sum(loads.weights, loads.time_constants_s, after - RAMP_S / 2))
    left -= 12 * (1 + _sum(lifts.weights, lifts.time_constants_s, after - 60 - 1.5 * RAMP_S))
    on = times[times > RAMP_S] < 60
    axes.plot(times[times > RAMP_S][on], held[on], **CLOSED, label="Eq 3, steps in mid-ramp")
    axes.plot(after, left, **CLOSED)
    note(axes, "residue, met by later loads", (85, 4.2), va="bottom")
    say(axes, "20 % strain held for a minute (8 wt%)", "time [s]", "change Δρ/ρ₀ [%]")
    axes.set_ylim(-0.7, 15)
    key(axes, "upper right")
    return figure


def unloading_spike() -> Canvas:
    """A sudden release, and one as the head lifts."""
    figure, (left, right) = panels(1, 1.3)
    spike = {"unloading-spike": {"size": 0.3, "decay_s": 0.8}}
    at_once = press((0.0, RAMP_S, 0.2), (60.0, 1e-6, -0.2))
    times = np.sort(np.append(np.linspace(59, 65, 121), [60.0, 60.0 + 2e-6]))
    plain = 100 * worlds.change_of(worlds.world(_CREEPING, at_once), times)
    left.plot(times, plain, **WITHOUT, label="without")
    found = worlds.change_of(worlds.world({**_CREEPING, **spike}, at_once), times)
    left.plot(times, 100 * found, color=BLUE, label="size = 0.3, decay_s = 0.8")
    after = times > 60
    lacks = 1.3 + sum(worlds.material().unloading_relaxation.weights)
    left.plot(
        times[after],
        plain[after] + lacks * 12 * np.exp(-(times[after] - 60) / 0.8),
        **CLOSED,
        label="closed form",
    )
    say(left, "Lifted at once", "time [s]", "change Δρ/ρ₀ [%]")
    times = np.linspace(58, 72, 281)
    right.plot(times, _percent(_CREEPING, times), **WITHOUT, label="without")
    right.plot(times, _percent({**_CREEPING, **spike}, times), color=BLUE, label="with")
    right.axvspan(60 + RAMP_S, 60 + 2 * RAMP_S, color="#f0f0f0", zorder=0, linewidth=0)
    note(right, "head lifts", (60 + 1.5 * RAMP_S, 0.3), ha="center", va="bottom")
    say(right, "Lifted by the head", "time [s]", "")
    for axes in (left, right):
        axes.set_ylim(0, 22)
        key(axes, "upper right")
    return figure


def residue() -> Canvas:
    """Minutes after a release."""
    figure, (axes,) = panels(1)
    times = np.concatenate([np.linspace(-10, 130, 150), np.linspace(135, 900, 80)])
    lasting = {**_CREEPING, "residue": {"share": 0.05, "decay_s": 300.0}}
    axes.plot(times, _percent(_CREEPING, times), **WITHOUT, label="without")
    axes.plot(times, _percent(lasting, times), color=BLUE, label="share = 0.05, decay_s = 300")
    after = times[times > 61]
    axes.plot(
        after, 0.05 * 12 * np.exp(-(after - 60 - 1.5 * RAMP_S) / 300), **CLOSED, label="share × 12 % × e^(−t/τ)"
    )
    say(axes, "What is left of a load of 20 % strain", "time since the press began [s]", "change Δρ/ρ₀ [%]")
    axes.set_ylim(-0.1, 2.2)
    note(axes, "held: up to 12 %", (110, 2.1), va="center")
    key(axes, "center right")
    return figure


def hysteresis() -> Canvas:
    """A loop, and a second press within it."""
    figure, (axes,) = panels(1)
    ramps = ((0.0, 20.0, 0.2), (20.0, 10.0, -0.1), (30.0, 10.0, 0.1), (40.0, 20.0, -0.2))
    loop = {**_QUASI_STATIC, "hysteresis": {"width": 0.2}}
    made, one = worlds.world(loop, press(*ramps)), press(*ramps)
    there, back = np.linspace(0, 20, 60), np.linspace(20, 60, 121)
    strain = np.array([one.strain_at(float(at)) for at in back])
    axes.plot(there, 100 * worlds.change_of(made, there), **WITHOUT, label="pressing: as without")
    axes.plot(100 * strain, 100 * worlds.change_of(made, back), color=BLUE, label="once it has lifted, width = 0.2")
    share = np.linspace(0, 1, 60)
    closed = 12 * share + 4 * 0.2 * 12 * share * (1 - share)
    axes.plot(20 * share, closed, **CLOSED, label="α ε + 4 w α εₘ x (1 − x)")
    say(axes, "Pressed to 20 %, lifted to 10 %, pressed again, lifted", "strain [%]", "change Δρ/ρ₀ [%]")
    key(axes, "upper left")
    return figure


def elastic_stress() -> Canvas:
    """Stress against strain for both materials."""
    figure, (axes,) = panels(1)
    strains = np.arange(0.05, 0.31, 0.05)
    for name, colour in (("cbsr-8wt", BLUE), ("cbsr-9wt", VERMILION)):
        of = worlds.material(name)
        made = worlds.world({"elastic-stress": {}}, of=of)
        found = []
        for strain in strains:
            made.presses[:] = [press((0.0, RAMP_S, float(strain)))]
            found.append(made.truth(60.0)[0].stress_kPa)
        axes.plot([0, 32], [0, 0.32 * of.modulus_kPa.value], **CLOSED)
        label = f"{name}: E = {of.modulus_kPa.value:g} kPa"
        axes.plot(100 * strains, found, "o", color=colour, markersize=3.5, label=label)
    say(axes, "Stress follows the strain", "strain [%]", "stress [kPa]")
    key(axes, "upper left")
    return figure


def stress_relaxation() -> Canvas:
    """A press held for a minute, and lifted."""
    figure, (axes,) = panels(1)
    times = np.linspace(-3, 95, 393)
    elastic = worlds.world({"elastic-stress": {}}, press(*_HOLD))
    made = worlds.world({"elastic-stress": {}, "stress-relaxation": {}}, press(*_HOLD))
    axes.plot(times, worlds.stress_of(elastic, times), **WITHOUT, label="elastic-stress alone")
    axes.plot(times, worlds.stress_of(made, times), color=BLUE, label="with stress-relaxation")
    kernel = worlds.material().stress_relaxation
    held = times[(times > RAMP_S) & (times < 61)]
    stress = 26.5 * (1 + _sum(kernel.weights, kernel.time_constants_s, held - RAMP_S / 2))
    axes.plot(held, stress, **CLOSED, label="Maxwell body, step in mid-ramp")
    note(axes, "a lifted head reads no pull", (65, 1.2), va="bottom")
    say(axes, "20 % strain held for a minute (8 wt%)", "time [s]", "stress [kPa]")
    axes.set_ylim(-1, 41)
    key(axes, "upper right")
    return figure


def confinement() -> Canvas:
    """How much stiffer a wide head meets the sheet."""
    figure, (axes,) = panels(1)
    widths = np.array([4.0, 8.0, 13.0, 16.0, 20.0])
    factors = []
    for width in widths:
        of = worlds.setting(head=Indenter(float(width)))
        effect = worlds.effect_factory("confinement")(of)
        at = Moment(of, 0.0, 0, [], [0.0], [1.0])
        effect.apply(at)
        factors.append(at.stress_kPa[0])
    along = np.linspace(0, 22, 60)
    axes.axhline(1, **WITHOUT)
    axes.plot(along, 1 + 2 * (along / 16) ** 2, **CLOSED, label="1 + 2 S², S = r/(2 t)")
    axes.plot(widths, factors, "o", color=BLUE, markersize=4, label="the effect")
    note(axes, "without", (21.9, 1.03), ha="right", va="bottom")
    note(
        axes,
        f"the shipped head: {factors[2]:.2f}",
        (13, factors[2]),
        xytext=(-4, 3),
        textcoords="offset points",
        ha="right",
    )
    say(axes, "A sheet of 4 mm that cannot bulge", "diameter of the head [mm]", "stress over E ε")
    axes.set_ylim(0, None)
    key(axes, "upper left")
    return figure


def load_cell_noise() -> Canvas:
    """A force trace."""
    figure, (axes,) = panels(1)
    times = np.arange(-16, 160) / 8
    ramps = ((0.0, RAMP_S, 0.2), (15.0, RAMP_S, -0.2))
    plain: worlds.Effects = {"elastic-stress": {}, "stress-relaxation": {}}
    noisy = {**plain, "load-cell-noise": {"rms_N": 0.05}}
    axes.plot(times, worlds.force_of(worlds.world(noisy, press(*ramps)), times), color=BLUE, label="rms_N = 0.05")
    axes.plot(times, worlds.force_of(worlds.world(plain, press(*ramps)), times), **CLOSED, label="without")
    say(axes, "Eight samples a second of a press of 20 %", "time [s]", "force [N]")
    key(axes, "upper right")
    return figure


def load_cell_saturation() -> Canvas:
    """A force trace beyond the limit."""
    figure, (axes,) = panels(1)
    times = np.arange(-16, 160) / 8
    ramps = ((0.0, 1.5 * RAMP_S, 0.3), (15.0, 1.5 * RAMP_S, -0.3))
    stiff: worlds.Effects = {"elastic-stress": {}, "stress-relaxation": {}, "confinement": {}}
    ends = {**stiff, "load-cell-saturation": {"limit_N": 7.35}}
    axes.plot(times, worlds.force_of(worlds.world(stiff, press(*ramps)), times), **WITHOUT, label="without")
    axes.plot(times, worlds.force_of(worlds.world(ends, press(*ramps)), times), color=BLUE, label="limit_N = 7.35")
    say(axes, "A press of 30 % under a confined head", "time [s]", "force read [N]")
    key(axes, "upper right")
    return figure


def _percent(effects: worlds.Effects, times_s: Array) -> Array:
    return 100 * worlds.change_of(worlds.world(effects, press(*_HOLD)), times_s)


def _sum(weights: tuple[float, ...], taus_s: tuple[float, ...], since_s: Array) -> Array:
    return np.array(sum(w * np.exp(-since_s / tau) for w, tau in zip(weights, taus_s, strict=True)))


FIGURES: Final[dict[str, Draw]] = {
    "piezoresistivity": piezoresistivity,
    "conductance-relaxation": conductance_relaxation,
    "unloading-spike": unloading_spike,
    "residue": residue,
    "hysteresis": hysteresis,
    "elastic-stress": elastic_stress,
    "stress-relaxation": stress_relaxation,
    "confinement": confinement,
    "load-cell-noise": load_cell_noise,
    "load-cell-saturation": load_cell_saturation,
}
