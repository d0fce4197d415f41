"""Two relaxations side by side, and their difference within the margins of equivalence."""

from collections.abc import Sequence
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.analysis.run_agreement import DirectedAgreement
from cbsr_qa.calibrate.relaxation_agreement import SHAPE_MARGIN, ComparedCurves
from cbsr_qa.domain.report import Figure
from cbsr_qa.report.style import BLUE, INK, QUIET, VERMILION, canvas, fit_left, light_grid
from cbsr_qa.report.svg import drawn

#: Standard errors of an interval of 90 %: the one that two one-sided tests at 5 % hold against the margin.
_NINETY: Final = 1.6449


def agreement_figure(compared: Sequence[DirectedAgreement], *, caption: str, alternative: str) -> Figure:
    """Draw both curves (above) and their difference with its 90 % interval and the margin (below), by direction.

    Parameters
    ----------
    compared : one column each; those without curves say why.
    """

    def build() -> Canvas:
        height_in = 3.3
        figure = canvas(height_in)
        grid = figure.add_gridspec(
            2,
            len(compared),
            left=0.085,
            right=0.985,
            bottom=0.42 / height_in,
            top=1 - 0.25 / height_in,
            hspace=0.18,
            wspace=0.2,
            height_ratios=(1.2, 1.0),
        )
        labelled: list[Axes] = []
        for column, one in enumerate(compared):
            above, below = (figure.add_subplot(grid[row, column]) for row in range(2))
            _draw(above, below, one)
            if column == 0 and one.found.curves is not None:
                above.set_ylabel("over the change")
                below.set_ylabel("difference")
                labelled += [above, below]
        fit_left(figure, grid, labelled)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw(above: Axes, below: Axes, one: DirectedAgreement) -> None:
    curves, after = one.found.curves, "press" if one.loading else "release"
    above.set_title(f"after the {after}", fontweight="normal")
    if curves is None:
        above.text(0.5, 0.5, "not compared", transform=above.transAxes, ha="center", color=QUIET)
        above.set_axis_off()
        below.set_axis_off()
        return
    _draw_curves(above, curves, one)
    _draw_difference(below, curves, str(one.found.shape))


def _draw_curves(axes: Axes, curves: ComparedCurves, one: DirectedAgreement) -> None:
    light_grid(axes)
    for values, stderr, colour, words in (
        (curves.first, curves.first_stderr, VERMILION, one.first),
        (curves.second, curves.second_stderr, BLUE, one.second),
    ):
        band = _NINETY * stderr
        axes.fill_between(curves.time_s, values - band, values + band, color=colour, alpha=0.15, linewidth=0)
        axes.plot(curves.time_s, values, color=colour, linewidth=1.1, label=words)
    axes.set_xlim(0, float(curves.time_s[-1]))
    axes.tick_params(labelbottom=False)
    axes.legend(frameon=False, fontsize=7, loc="lower right" if one.loading else "upper right")


def _draw_difference(axes: Axes, curves: ComparedCurves, words: str) -> None:
    light_grid(axes)
    band = _NINETY * curves.stderr
    difference = curves.difference
    axes.axhspan(-SHAPE_MARGIN, SHAPE_MARGIN, color=QUIET, alpha=0.12, linewidth=0)
    axes.fill_between(curves.time_s, difference - band, difference + band, color=BLUE, alpha=0.25, linewidth=0)
    axes.plot(curves.time_s, difference, color=INK, linewidth=1.0)
    axes.set_xlim(0, float(curves.time_s[-1]))
    reach = max(1.6 * SHAPE_MARGIN, 1.15 * float((abs(difference) + band).max()))
    axes.set_ylim(-reach, reach)
    axes.set_xlabel("time since the end of the ramp [s]")
    axes.text(0.98, 0.95, words, transform=axes.transAxes, ha="right", va="top", fontsize=7, color=INK)
