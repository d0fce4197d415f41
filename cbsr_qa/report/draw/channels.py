"""Values of single readings and electrode pairs, and readings of a reference ring against its closed form."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.report import Figure
from cbsr_qa.report.draw.sheet import add_scale
from cbsr_qa.report.draw.style import (
    AMOUNT_MAP,
    BLUE,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    WIDTH_IN,
    canvas,
    draw_svg,
    plot,
)
from cbsr_qa.report.tables import scale_unit, unit_column


@dataclass(frozen=True, slots=True)
class ChannelMark:
    """Readings to point at, e.g. saturated ones: (drive, measure) pairs, a matplotlib marker, a legend's words."""

    pairs: tuple[tuple[int, int], ...]
    symbol: str
    label: str


@draw_svg
def channel_map_figure(
    values: Array,
    *,
    label: str,
    unit: str,
    used: NDArray[np.bool_] | None = None,
    marks: Sequence[ChannelMark] = (),
) -> Canvas:
    """Draw one value per reading as a map, drive pairs down, measure pairs across.

    Parameters
    ----------
    values : (drives, measures) float64; not finite where there is no value (drawn empty).
    label, unit : what is shown and in what; the colours go from the 2nd to the 98th percentile.
    used : (drives, measures) bool; readings that are not used are drawn empty.
    marks : readings to point at, with a legend below the map; those without pairs are left out.
    """
    drives, measures = values.shape
    shown_mask = np.isfinite(values) & (True if used is None else used)
    size_in = 3.5
    tall_in = min(size_in * max(drives / measures, 0.12), 4.5)
    height_in = tall_in + 0.6
    figure = canvas(height_in, WIDTH_IN)
    left, bottom = (WIDTH_IN - size_in) / 2 / WIDTH_IN, 0.45 / height_in
    axes = figure.add_axes((left, bottom, size_in / WIDTH_IN, tall_in / height_in))
    lowest, highest = 0.0, 1.0
    if shown_mask.any():
        lowest, highest = (float(value) for value in np.percentile(values[shown_mask], (2, 98)))
        if not highest > lowest:
            lowest, highest = lowest - 0.5, highest + 0.5
    norm = Normalize(lowest, highest)
    _draw_map(axes, values, shown_mask, norm)
    _draw_marks(axes, marks)
    if shown_mask.any():
        add_scale(figure, axes, norm, AMOUNT_MAP, label=unit_column(label, unit), place="right")
    return figure


@draw_svg
def pair_bar_figure(
    values: Array,
    names: Sequence[str],
    *,
    label: str,
    unit: str,
    limits: tuple[float | None, float | None] = (None, None),
    outside: Sequence[int] = (),
) -> Canvas:
    """Draw one bar per electrode pair, with the allowed range (where there is one) and the median.

    Parameters
    ----------
    values : (pairs,) float64, finite, at least one.
    names : names of the pairs, e.g. ``"3–4"``.
    outside : pairs drawn in the warning colour.
    """
    figure = canvas(2.0)
    axes = plot(figure, (0.085, 0.22, 0.79, 0.68), x="electrode pair", y=unit_column(label, unit))
    colours = [VERMILION if pair in set(outside) else BLUE for pair in range(len(values))]
    axes.bar(np.arange(len(values)), values, width=0.72, color=colours, linewidth=0)
    axes.set_xticks(range(len(values)), names)
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.6, len(values) - 0.4)
    lines = [(float(np.median(values)), "median", INK, "solid")]
    bounds = zip(limits, ("lowest", "highest"), strict=True)
    lines += [(bound, name, VERMILION, "dashed") for bound, name in bounds if bound is not None]
    for level, name, colour, style in lines:
        axes.axhline(level, color=colour, linewidth=0.8, linestyle=style)
        axes.text(len(values) - 0.3, level, name, color=colour, va="center", fontsize=7)
    return figure


def _draw_map(axes: Axes, values: Array, shown: NDArray[np.bool_], norm: Normalize) -> None:
    drives, measures = values.shape
    for drive, measure in np.argwhere(~shown):
        axes.add_patch(Rectangle((measure - 0.5, drive - 0.5), 1, 1, facecolor="#f2f2f2", edgecolor="white", lw=0.4))
    edges_x, edges_y = np.arange(measures + 1) - 0.5, np.arange(drives + 1) - 0.5
    picture = np.ma.MaskedArray(values, mask=~shown)
    axes.pcolormesh(edges_x, edges_y, picture, norm=norm, cmap=AMOUNT_MAP, edgecolors="white", linewidth=0.4)
    axes.set_xlim(-0.5, measures - 0.5)
    axes.set_ylim(drives - 0.5, -0.5)
    axes.set_aspect("auto" if drives == 1 else "equal")
    axes.set_xticks(range(0, measures, max(1, measures // 16)))
    axes.set_yticks(range(0, drives, max(1, drives // 16)))
    axes.tick_params(length=0)
    axes.set_xlabel("measure pair")
    axes.set_ylabel("drive pair")
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)


def _draw_marks(axes: Axes, marks: Sequence[ChannelMark]) -> None:
    present_marks = [mark for mark in marks if mark.pairs]
    for mark in present_marks:
        drive, measure = np.array(mark.pairs).T
        axes.scatter(
            measure, drive, marker=mark.symbol, s=16, c=VERMILION, linewidths=1.1, label=mark.label, zorder=4
        )
    if present_marks:
        axes.legend(loc="upper right", bbox_to_anchor=(-0.12, 1.0), frameon=False, fontsize=7, labelcolor=QUIET)


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
    expected, mean : (drives, measures) readings in ``unit``.
    residual : (drives, measures) as a fraction of the expected reading.
    driven : (drives, measures) bool; readings that touch a driven electrode.
    used : (drives, measures) bool; readings without a flag, the others are not drawn.
    allowed : largest residual that is well, as a fraction.
    """
    kinds = [("touches no driven electrode", used & ~driven, BLUE), ("touches one", used & driven, VERMILION)]

    @draw_svg
    def build() -> Canvas:
        figure = canvas(2.6)
        _draw_comparison(figure, expected, mean, kinds, unit)
        axes = plot(figure, (0.52, 0.17, 0.46, 0.66), "Gain, offset and leads taken out")
        axes.set_xlabel("reading, drive pair after drive pair")
        axes.set_ylabel("residual of the reading [%]")
        number = np.arange(expected.size).reshape(expected.shape)
        for _, kind_mask, colour in kinds:
            axes.plot(number[kind_mask], 100 * residual[kind_mask], ".", color=colour, markersize=2.5)
        for limit in (-allowed, allowed):
            axes.axhline(100 * limit, color=INK, linewidth=0.8)
        return figure

    worst_percent = 100 * float(np.abs(np.where(used, residual, 0.0)).max())
    return Figure(
        "Left: mean reading over the closed form of the ring; a perfect station lies on the line. Right: what is left"
        f" of each reading, of what is expected, between the limits of ±{100 * allowed:.3g} %.",
        f"{int(used.sum())} readings against the closed form; the worst residual is {worst_percent:.3g} %.",
        build(),
    )


def _draw_comparison(
    figure: Canvas,
    expected: Array,
    mean: Array,
    kinds: Sequence[tuple[str, NDArray[np.bool_], str]],
    unit: str,
) -> None:
    """Left half: readings over the closed form, with the line of equality."""
    scale, shown_unit = scale_unit(float(np.abs(expected).max()), unit)
    labels = {"x": f"closed form [{shown_unit}]", "y": f"mean reading [{shown_unit}]"}
    axes = plot(figure, (0.09, 0.17, 0.33, 0.66), "Readings", grid="both", **labels)
    ends = np.array([expected.min(), expected.max()]) / scale
    axes.plot(ends, ends, color=FAINT, linewidth=0.8)
    for label, kind_mask, colour in kinds:
        if kind_mask.any():
            axes.plot(
                expected[kind_mask] / scale, mean[kind_mask] / scale, "o", color=colour, markersize=3, label=label
            )
    axes.legend(frameon=False, fontsize=6.5, labelcolor=QUIET, loc="upper left")
