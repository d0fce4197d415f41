"""Draw the figures of docs/explanation/force.md: how a map is learned from loads, and what stays undecided.

``python docs/figures/draw_force.py`` writes ``docs/explanation/figures/force/<figure>.svg``. The sheet is that of the
effect ``uneven-response``; loads are its response under the head with noise of their own, so that no sheet is solved.
The same software draws the same bytes.
"""

import sys
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure as Canvas
from simulation_figures import worlds
from simulation_figures.look import CLOSED, Draw, as_file, disc_map, key, panels, say
from simulation_figures.worlds import Array

from cbsr_qa.calibration.sheet import response_map, response_processes
from cbsr_qa.calibration.sheet.response_map import ResponseMap, learn_response
from cbsr_qa.plugin import NINE_LOCATIONS_MM
from cbsr_qa.report.draw.style import BLUE, VERMILION

FOLDER: Final = Path(__file__).resolve().parents[1] / "explanation" / "figures" / "force"

_UNEVEN: Final = {"uneven-response": {"deviation": 0.2, "correlation_mm": 20.0}}
#: Relative noise of a load: what readings, residue and contact height make of it.
_NOISE: Final = 0.015
_FURTHER: Final = 30
_HEAD_MM: Final = 6.5
_LOOKS: Final = ((9, VERMILION), (9 + _FURTHER, BLUE))


def spread_places() -> Array:
    """Nine locations and thirty on a sunflower of 38 mm radius (a golden angle apart)."""
    number = np.arange(_FURTHER) + 0.5
    radius, angle = 38 * np.sqrt(number / _FURTHER), number * np.pi * (3 - np.sqrt(5))
    further = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return np.concatenate([np.array(NINE_LOCATIONS_MM, dtype=np.float64), further])


def response_under_head(places_mm: Array) -> Array:
    """Mean of the sheet's response over the head at places (n, 2)."""
    radius = _HEAD_MM * np.sqrt((np.arange(6) + 0.5) / 6)
    turn = np.arange(12) * np.pi / 6
    ring = np.stack([np.outer(radius, np.cos(turn)), np.outer(radius, np.sin(turn))], axis=-1).reshape(-1, 2)
    design = worlds.design(_UNEVEN)
    mean: Array = np.mean([design.response_at(places_mm + step) for step in ring], axis=0)
    return mean


@cache
def learned(count: int) -> ResponseMap:
    """The map from so many of the places."""
    places = spread_places()[:count]
    noise = np.random.default_rng(4).normal(0, _NOISE, len(spread_places()))[:count]
    values = np.log(response_under_head(places)) + noise
    return learn_response(places, values, np.full(count, _NOISE**2), radius_mm=worlds.sensor_type().radius_mm)


def maps() -> Canvas:
    """The maps from nine and from 39 loads."""
    figure, axes = panels(1, 1)
    for one, (count, _) in zip(axes, _LOOKS, strict=True):
        disc_map(one, lambda places, n=count: np.exp(learned(n).predict(places)[0]), "response S")
        one.plot(*spread_places()[:count].T, "o", markersize=2.4, color="white", markeredgecolor="black",
                 markeredgewidth=0.5)  # fmt: skip
        one.set_title(f"From {count} loads")
    return figure


def section() -> Canvas:
    """Both maps along a diameter, with the truth."""
    figure, (one,) = panels(1)
    along = np.linspace(-48, 48, 97)
    places = np.column_stack([along, np.zeros(97)])
    for count, colour in _LOOKS:
        mean, variance = learned(count).predict(places)
        low, high = np.exp(mean - 2 * np.sqrt(variance)), np.exp(mean + 2 * np.sqrt(variance))
        one.fill_between(along, low, high, color=colour, alpha=0.2, linewidth=0)
        one.plot(along, np.exp(mean), color=colour, label=f"{count} loads, ± 2 errors")
    one.plot(along, response_under_head(places), **CLOSED, label="truth, under the head")
    say(one, "Along y = 0", "x [mm]", "response S")
    key(one, "upper right")
    return figure


def processes() -> Canvas:
    """What of the hyperparameters nine and 39 loads decide."""
    figure, axes = panels(1, 1, 1)
    radius = worlds.sensor_type().radius_mm
    said = (
        ("length over radius", "length_mm", 1 / radius),
        ("deviation [%]", "deviation", 100.0),
        ("scatter of loads [%]", "scatter", 100.0),
    )
    for one, (label, name, factor) in zip(axes, said, strict=True):
        for shift, (count, colour) in zip((-0.2, 0.2), _LOOKS, strict=True):
            found = learned(count)
            values = np.array([factor * getattr(member, name) for member in found.members])
            levels = np.unique(np.concatenate([_levels(name, factor, radius), values]).round(6))
            weight = [found.weights[np.isclose(values, level, atol=1e-6)].sum() for level in levels]
            one.bar(np.arange(len(levels)) + shift, weight, 0.4, color=colour, label=f"{count} loads")
            one.set_xticks(range(len(levels)), [f"{level:.2g}" for level in levels], fontsize=5.5)
        say(one, "", label, "weight" if one is axes[0] else "")
    key(axes[2])
    return figure


def _levels(name: str, factor: float, radius_mm: float) -> Array:
    """All that was tried, so that what got no weight is seen too."""
    tried = {
        "length_mm": radius_mm * response_map._LENGTHS,
        "deviation": response_processes._DEVIATIONS,
        "scatter": response_map._SCATTERS,
    }
    found: Array = factor * tried[name]
    return found


FIGURES: Final[dict[str, Draw]] = {"map": maps, "section": section, "processes": processes}


def main() -> int:
    """Draw all; return the exit status."""
    FOLDER.mkdir(exist_ok=True)
    for name, draw in FIGURES.items():
        (FOLDER / f"{name}.svg").write_text(as_file(name, draw), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
