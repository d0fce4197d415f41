"""Readings of a reference ring against its closed form."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Canvas
from numpy.typing import NDArray

from cbsr_qa.domain.report import Figure
from cbsr_qa.report.numbers import scaled_unit
from cbsr_qa.report.style import BLUE, FAINT, INK, QUIET, VERMILION, canvas, light_grid
from cbsr_qa.report.svg import drawn

Array = NDArray[np.float64]


def ring_figure(
    expected: Array,
    mean: Array,
    residual: Array,
    *,
    driven: NDArray[np.bool_],
    used: NDArray[np.bool_],
    allowed: float,
    unit: str,
) -> Figure:
    """Draw mean readings over the closed form, and what of each is left when gain, offset and leads are taken out.

    Parameters
    ----------
    expected, mean : (drives, measures) in ``unit``.
    residual : (drives, measures) as a fraction of the expected reading.
    driven : (drives, measures) bool; readings that touch a driven electrode.
    used : (drives, measures) bool; readings without a flag, the others are not drawn.
    allowed : largest residual that is well, as a fraction.
    """
    kinds = [("touches no driven electrode", used & ~driven, BLUE), ("touches one", used & driven, VERMILION)]

    def build() -> Canvas:
        figure = canvas(2.6)
        _compared(figure, expected, mean, kinds, unit)
        axes = figure.add_axes((0.52, 0.17, 0.46, 0.66))
        light_grid(axes)
        number = np.arange(expected.size).reshape(expected.shape)
        for _, which, colour in kinds:
            axes.plot(number[which], 100 * residual[which], ".", color=colour, markersize=2.5)
        for limit in (-allowed, allowed):
            axes.axhline(100 * limit, color=INK, linewidth=0.8)
        axes.set_xlabel("reading, drive pair after drive pair")
        axes.set_ylabel("left of the reading [%]")
        axes.set_title("Gain, offset and leads taken out")
        return figure

    worst = 100 * float(np.abs(np.where(used, residual, 0.0)).max())
    return drawn(
        build,
        caption="Left: mean reading over the closed form of the ring; a perfect station lies on the line. Right:"
        f" what is left of each reading, of what is expected, between the limits of ±{100 * allowed:.3g} %.",
        alternative=f"{int(used.sum())} readings against the closed form; the worst residual is {worst:.3g} %.",
    )


def _compared(
    figure: Canvas,
    expected: Array,
    mean: Array,
    kinds: Sequence[tuple[str, NDArray[np.bool_], str]],
    unit: str,
) -> None:
    """Left half: readings over the closed form, with the line of equality."""
    axes = figure.add_axes((0.09, 0.17, 0.33, 0.66))
    light_grid(axes, "both")
    scale, shown = scaled_unit(float(np.abs(expected).max()), unit)
    ends = np.array([expected.min(), expected.max()]) / scale
    axes.plot(ends, ends, color=FAINT, linewidth=0.8)
    for label, which, colour in kinds:
        if which.any():
            axes.plot(expected[which] / scale, mean[which] / scale, "o", color=colour, markersize=3, label=label)
    axes.set_xlabel(f"closed form [{shown}]")
    axes.set_ylabel(f"mean reading [{shown}]")
    axes.set_title("Readings")
    axes.legend(frameon=False, fontsize=6.5, labelcolor=QUIET, loc="upper left")
