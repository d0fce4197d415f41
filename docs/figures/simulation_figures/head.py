"""Effects on where the head gets to, and on where it meets the sheet."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure as Canvas

from cbsr_qa.plugin import NINE_LOCATIONS_MM
from cbsr_qa.report.draw.style import BLUE, QUIET, VERMILION
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa_plugins.hardware.simulated_bench import open_bench
from simulation_figures import worlds
from simulation_figures.look import CLOSED, WITHOUT, Draw, key, panels, say
from simulation_figures.worlds import MOTION


def misplaced_sheet() -> Canvas:
    """Where on the sheet the nine places are, and how far off."""
    figure, (left, right) = panels(1, 1.3, height_in=2.4)
    made = worlds.world({"misplaced-sheet": {"x_mm": 3.0, "y_mm": -2.0, "rotation_deg": 6.0}})
    told = np.array(NINE_LOCATIONS_MM)
    there = np.array([made.head_at((x, y, -25.0), (0.0, 0.0, -25.0), 0.0, 0)[:2] for x, y in told])
    turn = np.linspace(0, 2 * np.pi, 121)
    left.plot(50 * np.cos(turn), 50 * np.sin(turn), **WITHOUT)
    left.plot(*told.T, "o", color=QUIET, markersize=4, fillstyle="none", label="told")
    left.plot(*there.T, "o", color=BLUE, markersize=3, label="on the sheet")
    left.set(aspect="equal", xlim=(-53, 53), ylim=(-53, 53), xticks=(-50, 0, 50), yticks=(-50, 0, 50))
    say(left, "3, −2 mm, 6°", "x [mm]", "y [mm]", grid="")
    angle = np.radians(6.0)
    back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    closed = np.hypot(*((told - (3.0, -2.0)) @ back.T - told).T)
    right.plot(np.hypot(*(there - told).T), "o", color=BLUE, markersize=4, label="on the sheet")
    right.plot(closed, **CLOSED, label="R(−θ) (p − p₀) − p")
    right.set_ylim(0, 9)
    right.set_xticks(range(9), [f"L{k}" for k in range(9)])
    key(right, "upper right", ncols=2)
    say(right, "All are off, not alike in mm", "", "off by [mm]")
    return figure


def applicator_position_error() -> Canvas:
    """Where the head got to on 150 movements, from where it was told to go."""
    figure, (left, right) = panels(1, 1.3, height_in=2.2)
    made = worlds.world({"applicator-position-error": {"error_mm": 0.2, "depth_error_mm": 0.01}})
    told = (15.0, -15.0, 0.8)
    off = np.array([made.head_at(told, (0.0, 0.0, -25.0), 0.0, index) for index in range(150)]) - told
    turn = np.linspace(0, 2 * np.pi, 121)
    left.plot(*off[:, :2].T, "o", color=BLUE, markersize=1.8)
    left.plot(0.4 * np.cos(turn), 0.4 * np.sin(turn), **CLOSED, label="2 σ")
    left.set(aspect="equal", xlim=(-0.85, 0.85), ylim=(-0.85, 0.85), xticks=(-0.5, 0, 0.5), yticks=(-0.5, 0, 0.5))
    key(left, "upper right")
    say(left, "error_mm = 0.2", "reached − told, x [mm]", "y [mm]", grid="")
    right.hist(1e3 * off[:, 2], bins=20, range=(-35, 35), density=True, color=BLUE, label="150 movements")
    along = np.linspace(-35, 35, 141)
    right.plot(along, np.exp(-(along**2) / 200) / (10 * np.sqrt(2 * np.pi)), **CLOSED, label="Gaussian")
    say(right, "depth_error_mm = 0.01", "reached − told, depth [µm]", "density [1/µm]")
    right.set_ylim(0, 0.065)
    key(right, "upper left", ncols=2)
    return figure


def backlash() -> Canvas:
    """What is lacking on the way out and on the way back."""
    figure, (axes,) = panels(1)
    made = worlds.world({"backlash": {"play_mm": 0.2}})
    way = [*np.arange(0.0, 41.0, 5.0), *np.arange(35.0, -1.0, -5.0)]
    at = [0.0]
    for to in way[1:]:
        at.append(made.head_at((to, 0.0, -25.0), (at[-1], 0.0, -25.0), 0.0, 0)[0])
    off = [reached - to for reached, to in zip(at[1:], way[1:], strict=True)]
    out = len(way) // 2
    axes.axhline(0, **WITHOUT)
    axes.plot(way[1 : out + 1], off[:out], ">", color=BLUE, markersize=4, label="going to +x")
    axes.plot(way[out + 1 :], off[out:], "<", color=VERMILION, markersize=4, label="coming back")
    for half in (-0.1, 0.1):
        axes.axhline(half, **CLOSED)
    axes.annotate("± play_mm / 2", (17.5, 0.105), fontsize=7, ha="center", va="bottom")
    axes.set_ylim(-0.17, 0.17)
    say(axes, "play_mm = 0.2: short on the side it came from", "told x [mm]", "reached − told [mm]", grid="")
    key(axes, "center right")
    return figure


def sheet_seat() -> Canvas:
    """The plane along x, and where the surface search finds it."""
    figure, (axes,) = panels(1)
    scene = {
        "sheet-seat": {"error_mm": 0.05},
        "elastic-stress": {},
        "stress-relaxation": {},
        "load-cell-noise": {"rms_N": 0.01},
    }
    bench = open_bench(worlds.station(scene, VirtualClock()))
    along = np.linspace(-45.0, 45.0, 7)
    plane = [1e3 * bench.world.surface_mm(float(x), 0.0, 0.0) for x in along]
    found = [1e3 * (bench.find_surface(float(x), 0.0) - MOTION.hover_mm) for x in along]
    axes.axhline(0, **WITHOUT)
    axes.annotate("nominal", (46, 0), fontsize=7, va="bottom", ha="right", color=QUIET)
    axes.plot(along, plane, **CLOSED, label="the plane of this seed")
    axes.plot(along, found, "o", color=BLUE, markersize=4, label="found by the surface search")
    say(axes, "error_mm = 0.05: the sheet lies askew", "x [mm]", "surface below nominal [µm]")
    axes.margins(y=0.2)
    key(axes)
    return figure


FIGURES: Final[dict[str, Draw]] = {
    "misplaced-sheet": misplaced_sheet,
    "applicator-position-error": applicator_position_error,
    "backlash": backlash,
    "sheet-seat": sheet_seat,
}
