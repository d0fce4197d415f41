"""Where on the sheet limits were met and where not, to be read without colour."""

from collections.abc import Sequence
from math import ceil
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Circle

from cbsr_qa.domain.outcome import SEVERITY, Outcome
from cbsr_qa.domain.report import Figure
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.report.sheet import draw_electrodes, draw_sheet, fit_sheet
from cbsr_qa.report.style import INK, WIDTH_IN, bare, canvas
from cbsr_qa.report.svg import drawn
from cbsr_qa.report.verdicts import SIGNS, LocationVerdict

_ACROSS: Final = 3
_SIDE_IN: Final = 2.1
_ROW_IN: Final = 2.62
#: More places than this stand too close for their names.
_MOST_NAMES: Final = 16
#: As dark in grey print as the outcome is bad; the edge tells them apart besides.
_LOOK: Final[dict[Outcome, dict[str, Any]]] = {
    Outcome.PASS: {"facecolor": "#e9f5f0", "edgecolor": "#00664b", "linewidth": 0.8},
    Outcome.MARGINAL: {"facecolor": "#f3d9a0", "edgecolor": "#8a5a00", "linewidth": 1.1, "linestyle": (0, (3, 1.5))},
    Outcome.FAIL: {"facecolor": "#a32900", "edgecolor": "#5e1800", "linewidth": 1.6},
    Outcome.NOT_MEASURED: {
        "facecolor": "white",
        "edgecolor": "#4d4d4d",
        "linewidth": 1.1,
        "linestyle": (0, (1, 1.5)),
    },
}


def verdict_figure(
    verdicts: Sequence[LocationVerdict], sensor: SensorType, *, caption: str, alternative: str
) -> Figure:
    """Draw a sheet for each phase with the outcome of every place.

    Parameters
    ----------
    verdicts : at least one.
    """

    def build() -> Canvas:
        phases = list(dict.fromkeys(one.phase for one in verdicts))
        rows = ceil(len(phases) / _ACROSS)
        height_in = rows * _ROW_IN
        figure = canvas(height_in)
        across = min(len(phases), _ACROSS)
        step_in = WIDTH_IN / across if across > 1 else _SIDE_IN + 0.2
        for number, phase in enumerate(phases):
            row, column = divmod(number, _ACROSS)
            left_in = column * step_in + (step_in - _SIDE_IN) / 2 * (across > 1)
            bottom_in = height_in - (row + 1) * _ROW_IN + 0.24
            axes = figure.add_axes(
                (left_in / WIDTH_IN, bottom_in / height_in, _SIDE_IN / WIDTH_IN, _SIDE_IN / height_in)
            )
            _draw_phase(axes, phase, [one for one in verdicts if one.phase == phase], sensor)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def outcome_counts(verdicts: Sequence[LocationVerdict]) -> str:
    """Count outcomes in words, the best first: ``7 pass, 1 marginal, 1 fail``."""
    counts = [(outcome, sum(one.outcome is outcome for one in verdicts)) for outcome in reversed(SEVERITY)]
    return ", ".join(f"{count} {outcome.value}" for outcome, count in counts if count)


def _draw_phase(axes: Axes, phase: str, verdicts: Sequence[LocationVerdict], sensor: SensorType) -> None:
    bare(axes)
    draw_sheet(axes, sensor.outline, filled=True)
    draw_electrodes(axes, sensor.electrodes, sensor.outline, numbered=False)
    radius_mm = _disc_mm(verdicts, sensor)
    named = len(verdicts) <= _MOST_NAMES
    # The worst last, so that none hides below a neighbour that passed.
    for one in sorted(verdicts, key=lambda v: -SEVERITY.index(v.outcome)):
        axes.add_patch(Circle((one.x_mm, one.y_mm), radius_mm, zorder=4, **_LOOK[one.outcome]))
        sign = SIGNS[one.outcome]
        text = f"{sign}\n{one.label}" if named else sign
        colour = "white" if one.outcome is Outcome.FAIL else INK
        axes.text(one.x_mm, one.y_mm, text, ha="center", va="center", fontsize=5.5, linespacing=0.95,
                  color=colour, fontweight="bold" if one.outcome is not Outcome.PASS else "normal",
                  zorder=6)  # fmt: skip
    fit_sheet(axes, sensor.outline)
    axes.set_title(phase, loc="center", pad=2, fontweight="normal")
    axes.text(0.5, -0.015, outcome_counts(verdicts), transform=axes.transAxes, ha="center", va="top", fontsize=7)


def _disc_mm(verdicts: Sequence[LocationVerdict], sensor: SensorType) -> float:
    """Radius that lets neighbours stand clear of each other, and a sign fit in."""
    at = np.array([(one.x_mm, one.y_mm) for one in verdicts])
    apart = np.hypot(*(at[:, None, :] - at[None, :, :]).transpose(2, 0, 1))
    nearest = float(np.min(apart, where=apart > 1e-9, initial=0.34 * sensor.radius_mm))
    return float(np.clip(0.48 * nearest, 0.06 * sensor.radius_mm, 0.16 * sensor.radius_mm))
