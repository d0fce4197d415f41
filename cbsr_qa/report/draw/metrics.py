"""Spatial metrics against time (the paper's Figs 10 and E.23), and size of regions against size of what presses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter, NullFormatter
from matplotlib.transforms import blended_transform_factory

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.results.observation import MetricTimeline
from cbsr_qa.report.draw.style import (
    BLUE,
    CYCLE,
    DASHED,
    FAINT,
    INK,
    ORDERED,
    QUIET,
    annotate,
    canvas,
    draw_svg,
    fit_left,
    note,
    plot,
    spread_labels,
)
from cbsr_qa.report.draw.time import thin_trace

_FORCE = "#f6d7a7"  # light orange, as in the paper
_FORCE_INK = "#a86400"


@dataclass(frozen=True, slots=True)
class Held:
    """When a load was held [s], and its name."""

    label: str
    start_s: float
    end_s: float


@draw_svg
def mask_timeline_figure(timeline: MetricTimeline, held: Sequence[Held]) -> Canvas:
    """Draw the three spatial metrics of every frame for every mask, while a load was held, with the force behind."""
    figure = canvas(5.0)
    grid = figure.add_gridspec(3, 1, left=0.075, right=0.845, bottom=0.085, top=0.945, hspace=0.14)
    rows = (
        ("error E_CoM [mm]", timeline.error_mm),
        ("overlap A_OL [%]", timeline.overlap_percent),
        ("shape deviation [mm²]", timeline.deviation_mm2),
    )
    start_s = held[0].start_s if held else float(timeline.time_s[0])
    labelled: list[Axes] = []
    for row, (name, values) in enumerate(rows):
        axes = plot(figure, grid[row], y=name)
        _draw_masks(axes, timeline, values, held, start_s)
        _draw_force(figure, axes, timeline.force, held, start_s, labelled=row == 1)
        labelled.append(axes)
        axes.tick_params(labelbottom=row == 2)
        if row == 0:
            _name_loads(axes, held, start_s)
            _name_masks(axes, timeline.masks)
    axes.set_xlabel("time since the first press [min]")
    fit_left(figure, grid, labelled)
    return figure


@draw_svg
def waiting_figure(timeline: MetricTimeline, mask: int, held: Sequence[Held]) -> Canvas:
    """Draw error and overlap of one mask against the time held: what waiting buys."""
    figure = canvas(1.95)
    grid = figure.add_gridspec(1, 2, left=0.075, right=0.985, bottom=0.2, top=0.88, wspace=0.2)
    rows = (("error E_CoM [mm]", timeline.error_mm[mask]), ("overlap A_OL [%]", timeline.overlap_percent[mask]))
    for column, (name, values) in enumerate(rows):
        axes = plot(figure, grid[column], name, x="time held [s]")
        time_s, mean, low, high = average_over_holds(timeline.time_s, values, held)
        axes.fill_between(time_s, low, high, color=BLUE, alpha=0.16, linewidth=0)
        axes.plot(time_s, mean, color=BLUE, marker="o", markersize=2.2)
        axes.set_xlim(left=0)
        if column == 0:
            axes.set_ylim(bottom=0)
    return figure


def average_over_holds(time_s: Array, values: Array, held: Sequence[Held]) -> tuple[Array, Array, Array, Array]:
    """Average a metric over loads at the same number of frames into the hold.

    Parameters
    ----------
    time_s, values : (n,); NaN where nothing was seen.

    Returns
    -------
    Mean time held [s], mean, lower and upper quartile, each (k,): only ranks where at least half of the loads
    have a value.
    """
    series = []
    for stretch in held:
        inside_mask = (time_s >= stretch.start_s) & (time_s < stretch.end_s)
        series.append((time_s[inside_mask] - stretch.start_s, values[inside_mask]))
    longest = max((len(s[0]) for s in series), default=0)
    times, table = np.full((len(series), longest), np.nan), np.full((len(series), longest), np.nan)
    for row, (hold_times, hold_values) in enumerate(series):
        times[row, : len(hold_times)], table[row, : len(hold_values)] = hold_times, hold_values
    covered_mask = np.isfinite(table).sum(axis=0) * 2 >= max(len(series), 1)
    if not covered_mask.any():
        empty = np.zeros(0)
        return empty, empty, empty, empty
    times, table = times[:, covered_mask], table[:, covered_mask]
    low, high = np.nanpercentile(table, (25, 75), axis=0)
    return np.nanmean(times, axis=0), np.nanmean(table, axis=0), low, high


def _draw_masks(axes: Axes, timeline: MetricTimeline, values: Array, held: Sequence[Held], start_s: float) -> None:
    minutes = (timeline.time_s - start_s) / 60
    for number, series in enumerate(values):
        colour = mask_colour(number, len(values))
        for stretch in held:
            inside_mask = (timeline.time_s >= stretch.start_s) & (timeline.time_s < stretch.end_s)
            axes.plot(
                minutes[inside_mask],
                series[inside_mask],
                color=colour,
                linewidth=0.9 + 0.12 * number,
                zorder=3 + number,
            )
    _scale(axes, values)
    axes.set_zorder(2)


def _scale(axes: Axes, values: Array) -> None:
    """Start at zero; where masks differ by more than a factor of thirty, use powers of ten instead."""
    finite_values = values[np.isfinite(values)]
    if (
        finite_values.size
        and finite_values.min() > 0
        and np.percentile(finite_values, 98) / np.percentile(finite_values, 2) > 30
    ):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0)


def _draw_force(
    figure: Canvas,
    axes: Axes,
    force: SampleBlock | None,
    held: Sequence[Held],
    start_s: float,
    *,
    labelled: bool,
) -> None:
    if force is None or not len(force):
        return
    force_axes = axes.twinx()
    force_axes.set_zorder(1)
    end_s = held[-1].end_s + 5 if held else float(force.time_s[-1])
    inside_mask = (force.time_s >= start_s - 5) & (force.time_s <= end_s)
    time_s, newtons = thin_trace(force.time_s[inside_mask], force.values[inside_mask], 700)
    force_axes.fill_between((time_s - start_s) / 60, 0, newtons, color=_FORCE, linewidth=0, alpha=0.75)
    force_axes.set_ylim(0, 1.25 * max(float(newtons.max(initial=0.0)), 1e-9))
    force_axes.tick_params(colors=_FORCE_INK, labelcolor=_FORCE_INK, right=labelled, labelright=labelled)
    if labelled:
        force_axes.spines["right"].set(visible=True, color=_FORCE_INK)
        force_axes.set_ylabel("force [N]", color=_FORCE_INK)
    axes.patch.set_visible(False)


def _name_loads(axes: Axes, held: Sequence[Held], start_s: float) -> None:
    data_and_axes = blended_transform_factory(axes.transData, axes.transAxes)
    every = max(1, len(held) // 18)
    for stretch in held[::every]:
        middle = ((stretch.start_s + stretch.end_s) / 2 - start_s) / 60
        axes.text(
            middle, 1.03, stretch.label, transform=data_and_axes, ha="center", va="bottom", fontsize=7, color=INK
        )


def _name_masks(axes: Axes, masks: Sequence[float]) -> None:
    note(axes, 1.075, 1.0, "mask", QUIET, va="top")
    heights = spread_labels([0.84 - 0.17 * number for number in range(len(masks))], 0.15)
    for number, (fraction, height) in enumerate(zip(masks, heights, strict=True)):
        colour = mask_colour(number, len(masks))
        axes.plot([1.075, 1.105], [height] * 2, transform=axes.transAxes, color=colour, linewidth=2, clip_on=False)
        note(axes, 1.115, height, f"{100 * fraction:g} %", va="center")


def mask_colour(number: int, count: int) -> str:
    """Return the colour of the number-th of ``count`` masks, light to dark."""
    if count == 1:
        return ORDERED[-1]
    return ORDERED[round(number * (len(ORDERED) - 1) / (count - 1))]


@dataclass(frozen=True, slots=True)
class SizeSeries:
    """Diameters of targets and of circles with the regions' areas, at one place [mm]."""

    title: str
    targets_mm: tuple[float, ...]
    regions_mm: tuple[float, ...]


@draw_svg
def size_figure(series: Sequence[SizeSeries], head_mm: float) -> Canvas:
    """Draw regions' diameters against targets', with the line on which they are equal and the head's size marked."""
    figure = canvas(2.1)
    labels = {"x": "diameter of the target [mm]", "y": "diameter of the region [mm]"}
    axes = plot(figure, (0.075, 0.19, 0.4, 0.74), grid="both", **labels)
    largest = 1.12 * max(max((*place.targets_mm, *place.regions_mm)) for place in series)
    axes.plot([0, largest], [0, largest], color=FAINT, linestyle=DASHED, zorder=1)
    equal = (0.9 * largest, 0.97 * largest)
    annotate(axes, "as large as the target", equal, (-4, 0), QUIET, ha="right", va="top")
    axes.axvline(head_mm, color=FAINT, linewidth=0.6, zorder=1)
    annotate(axes, "head", (head_mm, 0), (3, 3), QUIET)
    for number, (place, colour) in enumerate(zip(series, CYCLE, strict=False)):
        axes.plot(place.targets_mm, place.regions_mm, color=colour, marker="os^"[number % 3], markersize=4, zorder=3)
        end = (place.targets_mm[-1], place.regions_mm[-1])
        annotate(axes, place.title, end, (6, 0), va="center", annotation_clip=False)
    ticks = np.arange(0, largest, 5 if largest < 40 else 10 if largest < 80 else 20)
    axes.set(xlim=(0, largest), ylim=(0, largest), xticks=ticks, yticks=ticks)
    return figure
