"""Effects on the sheet as it is made."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure as Canvas

from cbsr_qa.report.draw.style import BLUE, QUIET, VERMILION
from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.system.clock import VirtualClock
from simulation_figures import worlds
from simulation_figures.look import CLOSED, WITHOUT, Draw, by_electrode, disc_map, key, outline, panels, say
from simulation_figures.worlds import HEAD, MOTION, NINE_MM, Array

_UNEVEN: Final = {"deviation": 0.2, "correlation_mm": 20.0}


def uneven_conductance() -> Canvas:
    """The factor on the disc, and what neighbouring electrodes show of it."""
    figure, (left, right) = panels(1.15, 1)
    made = worlds.world({"uneven-conductance": _UNEVEN})
    disc_map(left, made.sheet.design.sheet_conductance_at, "conductance over its mean")
    left.set_title("One seed, deviation 0.2 over 20 mm")
    ohm = worlds.neighbours_ohm(made) / 1e3
    right.bar(range(16), ohm, color=BLUE, width=0.7)
    mean = worlds.material().interelectrode_resistance_ohm.value / 1e3
    right.axhline(mean, **CLOSED, label="the material's mean")
    say(right, "The mean stays the material's", "", "between neighbours [kΩ]")
    right.set_ylim(0, 1.35 * ohm.max())
    by_electrode(right, "pair of electrodes")
    key(right, "upper left")
    return figure


def uneven_response() -> Canvas:
    """The factor on the disc, and how much more or less the readings answer the same press."""
    figure, (left, right) = panels(1.15, 1)
    uneven = {"uneven-response": _UNEVEN, "piezoresistivity": {}}
    made = worlds.world(uneven)
    disc_map(left, made.sheet.design.response_at, "response over its mean")
    for number, (x_mm, y_mm) in enumerate(NINE_MM):
        left.annotate(f"L{number}", (x_mm, y_mm), fontsize=5.5, ha="center", va="center")
    left.set_title("One seed, deviation 0.2 over 20 mm")
    even: worlds.Effects = {"piezoresistivity": {}}
    ratios = _answers(uneven) / _answers(even)
    under = [float(made.sheet.design.response_at(_under_head(*place)).mean()) for place in NINE_MM]
    ends = np.array([min(under) - 0.05, max(under) + 0.05])
    right.plot(ends, ends, **CLOSED, label="in proportion")
    right.plot(under, ratios, "o", color=BLUE, markersize=3.5, label="simulated")
    say(right, "Pressed at L0 to L8, 20 %", "mean factor under the head", "change of readings, × even")
    key(right, "upper left")
    return figure


def batch_pattern() -> Canvas:
    """Maps of two sensors of a batch, and how alike their responses are at the same places."""
    figure, axes = panels(1, 1, 1.1)
    pattern = {"rho": 0.9, "batch": "41", "deviation": 0.2, "correlation_mm": 35.0}
    designs = [worlds.design({"batch-pattern": pattern}, seed=seed) for seed in (1, 2)]
    for number, design in enumerate(designs):
        disc_map(axes[number], design.response_at, "response over its mean")
        axes[number].set_title(f"Sensor {number + 1}")
    along = np.arange(-36.0, 37.0, 12.0)
    places = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    places = places[np.hypot(*places.T) < 45]
    first, second = (np.log(design.response_at(places)) for design in designs)
    ends = np.array([min(first.min(), second.min()), max(first.max(), second.max())])
    axes[2].plot(ends, ends, **CLOSED, label="alike")
    axes[2].plot(first, second, "o", color=BLUE, markersize=2.5)
    say(axes[2], "ρ = 0.9", "sensor 1, logarithm", "sensor 2")
    key(axes[2], "upper left")
    return figure


def uneven_thickness() -> Canvas:
    """The thickness on the disc, and the strain of one depth."""
    figure, (left, right) = panels(1.15, 1)
    made = worlds.world({"uneven-thickness": {"deviation": 0.1, "correlation_mm": 20.0}})
    disc_map(left, made.sheet.design.thickness_mm_at, "thickness [mm]")
    left.set_title("One seed, deviation 0.1 over 20 mm")
    head = SimulatedHead(VirtualClock(), made, MOTION, role="head")
    for place in NINE_MM:
        head.travel(*place)
        head.press(0.8, MOTION.press_speed_mm_s)
    thick = [made.thickness_mm(one.x_mm, one.y_mm) for one in made.presses]
    strain = [sum(step.change for step in one.steps if step.change > 0) for one in made.presses]
    along = np.linspace(min(thick) - 0.1, max(thick) + 0.1, 50)
    right.plot(along, 100 * 0.8 / along, **CLOSED, label="depth / thickness")
    right.plot(thick, 100 * np.array(strain), "o", color=BLUE, markersize=3.5, label="at L0 to L8")
    say(right, "Pressed 0.8 mm deep", "thickness there [mm]", "strain under the head [%]")
    key(right, "upper right")
    return figure


def contact_spread() -> Canvas:
    """The contacts, and what the driven pairs show of them."""
    figure, (left, right) = panels(1, 1)
    made = worlds.world({"contact-spread": {"deviation": 0.5}})
    left.bar(range(16), made.sheet.design.contact_mm, color=BLUE, width=0.7)
    left.axhline(0.2, **WITHOUT, label="without: all alike")
    left.set_ylim(0, 0.36)
    key(left, "upper left")
    say(left, "One seed, deviation 0.5", "", "contact over sheet [mm]")
    by_electrode(left)
    plain = worlds.neighbours_ohm(worlds.world({}))
    right.plot(range(16), plain / 1e3, "_", color=QUIET, markersize=7, label="alike")
    right.plot(range(16), worlds.neighbours_ohm(made) / 1e3, "o", color=BLUE, markersize=3.5, label="scattered")
    say(right, "What driven pairs show", "", "between neighbours [kΩ]")
    right.margins(y=0.25)
    by_electrode(right, "pair of electrodes")
    key(right, "upper right", ncols=2)
    return figure


def pin_position_error() -> Canvas:
    """Pins and where they are indeed, and readings that would not show it."""
    figure, (left, right) = panels(1, 1.35)
    made = worlds.world({"pin-position-error": {"error_mm": 0.2}})
    told = made.setting.sensor_type.electrodes.positions_mm()
    off = made.sheet.design.shift_mm
    outline(left)
    left.quiver(*told.T, *off.T, color=VERMILION, angles="xy", scale_units="xy", scale=1 / 30, width=0.012, zorder=3)
    left.set_title("Off by 0.2 mm, drawn × 30")
    plain = worlds.world({}).frame(0.0, 0).voltages
    change = 100 * (made.frame(0.0, 0).voltages / plain - 1)
    used = made.setting.sensor_type.pattern.usable()
    rows = [change[drive, used[drive]] for drive in range(16)]
    right.vlines(range(16), [row.min() for row in rows], [row.max() for row in rows], color=BLUE, linewidth=3)
    right.axhline(0, **WITHOUT)
    say(right, "Used readings, least to most", "", "against pins in place [%]")
    by_electrode(right, "drive pair")
    return figure


def head_edge() -> Canvas:
    """The strain across the head."""
    figure, (axes,) = panels(1)
    across = np.linspace(-10, 10, 801)
    radius = HEAD.radius_mm
    axes.plot(across, _across({}, across), **WITHOUT, label="without: a sharp edge")
    width = 4.0
    linear = np.clip((radius + width / 2 - np.abs(across)) / width, 0, 1)
    # The heads within each other hold their areas together: the linear fall is as high as keeps what presses in all.
    soft = _across({"head-edge": {"width_mm": width}}, across)
    axes.plot(across, soft, color=BLUE, label="width_mm = 4: eight nested heads")
    axes.plot(across, linear * soft.max(), **CLOSED, label="linear fall")
    say(axes, "Strain under a head of 13 mm with a soft edge", "from the axis [mm]", "strain over nominal")
    axes.set_ylim(0, 1.1)
    key(axes, "lower center")
    return figure


def pressure_profile() -> Canvas:
    """The response across the head for both profiles."""
    figure, all_axes = panels(1, 1)
    across = np.linspace(-8, 8, 641)
    share = np.clip(np.abs(across) / HEAD.radius_mm, 0, 1 - 1e-9)
    inside = np.abs(across) < HEAD.radius_mm
    closed = {"punch": 0.5 / np.sqrt(1 - share**2), "parabola": 2 * (1 - share**2)}
    for axes, (shape, exact) in zip(all_axes, closed.items(), strict=True):
        axes.plot(across, _across({}, across), **WITHOUT, label="without: even")
        found = _across({"pressure-profile": {"shape": shape}}, across)
        axes.plot(across, found, color=BLUE, label="ten annuli")
        axes.plot(across[inside], np.minimum(exact[inside], 3), **CLOSED, label="closed form")
        say(axes, f'shape = "{shape}"', "from the axis [mm]", "pressure over its mean")
        axes.set_ylim(0, 2.9)
        key(axes, "upper center" if shape == "punch" else "upper right")
    return figure


def _across(effects: worlds.Effects, at_mm: Array) -> Array:
    """What nested heads add up to along a line through the axis."""
    rings = worlds.design(effects).rings
    return np.array(sum(ring.weight * (np.abs(at_mm) <= ring.size * HEAD.radius_mm) for ring in rings))


def _answers(effects: worlds.Effects) -> Array:
    """Size of the change of all used readings to 20 % strain at the nine places."""
    used = worlds.sensor_type().pattern.usable()
    made = worlds.world(effects)
    before = made.frame(0.0, 0).voltages[used]
    found = []
    for x_mm, y_mm in NINE_MM:
        made.presses[:] = [worlds.press((0.0, 1.0, 0.2), x_mm=x_mm, y_mm=y_mm)]
        found.append(float(np.linalg.norm(made.frame(10.0, 0).voltages[used] - before)))
    return np.array(found)


def _under_head(x_mm: float, y_mm: float) -> Array:
    along = np.linspace(-HEAD.radius_mm, HEAD.radius_mm, 25)
    places = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    under: Array = places[np.hypot(*places.T) < HEAD.radius_mm] + np.array([x_mm, y_mm])
    return under


FIGURES: Final[dict[str, Draw]] = {
    "uneven-conductance": uneven_conductance,
    "uneven-response": uneven_response,
    "batch-pattern": batch_pattern,
    "uneven-thickness": uneven_thickness,
    "contact-spread": contact_spread,
    "pin-position-error": pin_position_error,
    "head-edge": head_edge,
    "pressure-profile": pressure_profile,
}
