"""The page of ``cbsr-qa frontier``: how to read it, the plots, one table a series."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.results import Banner, Block, Figure, Page, Paragraph, Section
from cbsr_qa.report import render_sections, text_table, unit_column, write_report
from cbsr_qa.report.draw import CYCLE, FAINT, INK, QUIET, canvas, drawing, drawn, light_grid
from cbsr_qa.studies.frontier.point import Accuracy, Clock, Knob, Point
from cbsr_qa.studies.frontier.station import PAPER
from cbsr_qa.studies.frontier.study import check_png

if TYPE_CHECKING:
    from cbsr_qa.studies.frontier.study import Frontier

_READING: Final = (
    "Every point is a way to do the same thing: to calibrate a sensor, or to compute an image. Further down is more "
    "accurate, further left is quicker. A filled point is worth its time: nothing that was tried is as accurate for "
    "less. A hollow one is not: some filled point costs less and is as good, as far as anybody can tell.",
    "Station time is what a sensor occupies the rig: rests, travel and finding the surface are in it. Accuracy is "
    "against known truth, which only a simulation has: sensors whose response varies by 20 % over the sheet, with "
    "noise, relaxation, and a residue of earlier presses. Force errors are root mean squares over random loads of 5 "
    "to 30 % strain (0.9 to 5.3 N), held for a minute after a minute's rest, that the calibration has not seen; bars "
    "are one standard error over the simulated sensors. Ways to calibrate are compared by force and map together.",
    "Transients averaged: the last frames of a hold count as they are. Predicted: a short hold is brought to where a "
    "long one ends, with the sensor's own relaxation from three long holds.",
)
_OF_COMPUTER: Final = (
    "Of the computer, time is that of one core for a new conductance, an image, or a frame. Voltages are held "
    "against exact ones (multipoles, Fourier series): their error unloaded and with an inclusion in the sheet, and "
    "that of the change that a load makes, which is what images are made of.",
    "Images are of simulated sensors pressed at nine known places. E_CoM is how far the middle of the region that is "
    "found lies from the head's, A_OL how much of the two areas overlaps (100 % were the head's own outline), SD the "
    "area by which their shapes differ; missed is the share of loads that leave no region. Smoothing over own is the "
    "method's regularisation parameter over the one it chooses itself.",
)
_NAMES: Final[Mapping[str, str]] = {
    "force_error": "force error, place known",
    "force_error_found": "force error, place found",
    "map_error": "map",
    "gauge_factor_error": "gauge factor",
    "settling_error": "settling time",
    "voltage_error_inclusion": "voltage error, inclusion",
    "load_signal_error": "error of a load's signal",
    "image_error": "error of the image",
    "E_CoM": "E_CoM",
    "A_OL": "A_OL",
}
#: Units that names of knobs end in.
_UNITS: Final = ("s", "mm")
_HEIGHT_IN: Final = 3.6
_COLOURS: Final = (*CYCLE, INK)  # one a series


def write_page(found: "Frontier", path: Path) -> None:
    """Write a page that stands by itself.

    Raises
    ------
    RefusedError
        If its folder cannot be written to.
    """
    write_report(path, render_sections(frontier_page(found), frontier_sections(found)))


def frontier_page(found: "Frontier") -> Page:
    """Say what the page begins with."""
    chosen = found.recommended
    if chosen is None:
        banner = Banner("plain", "–", "No setting recommended", found.why_not)
    else:
        minutes = (chosen.point.station_s or 0) / 60
        force = _shown(chosen.point.accuracy["force_error"])
        banner = Banner("pass", "✓", f"{force} in {minutes:.0f} min", chosen.why)
    counts = {clock: sum(point.clock is clock for point in found.points) for clock in Clock}
    identity = (
        ("Settings of the station", str(counts[Clock.STATION])),
        ("Settings of the computer", str(counts[Clock.COMPUTER])),
        ("Worth their time", str(sum(found.pareto))),
        ("Sweep", "quick: few settings, one sensor" if found.quick else "whole"),
    )
    simulated = ("sensors, station and readings",) if counts[Clock.STATION] else ()
    return Page("Frontier", "What accuracy costs in time", banner, identity, simulated, ())


def frontier_sections(found: "Frontier") -> tuple[Section, ...]:
    """Return how to read it with the station's plot, then one section a series."""
    clocks = {point.clock for point in found.points}
    words: tuple[str, ...] = _READING if Clock.STATION in clocks else _READING[:1]
    words += _OF_COMPUTER if Clock.COMPUTER in clocks else ()
    blocks: list[Block] = [Paragraph(one) for one in words]
    if any("force_error" in point.accuracy for point, _ in _station(found)):
        blocks.append(station_figure(found))
    series = dict.fromkeys((point.clock, point.series) for point in found.points)
    return (Section("How to read this page", tuple(blocks)), *(_series(found, *one) for one in series))


def station_figure(found: "Frontier") -> Figure:
    """Draw force error against minutes of the station."""
    return drawn(
        lambda: station_canvas(_station(found), _chosen(found)),
        caption="Force error on loads the calibration has not seen, against what it takes of the station. Filled: "
        "worth its time. Squares: transients predicted. Ring: recommended, the most accurate of those that were "
        "allowed; a quicker one may be as good as far as anybody can tell.",
        alternative="Force errors against station time; the tables below have the numbers.",
    )


def _station(found: "Frontier") -> list[tuple[Point, bool]]:
    return [(p, on) for p, on in zip(found.points, found.pareto, strict=True) if p.clock is Clock.STATION]


def _chosen(found: "Frontier") -> Point | None:
    return None if found.recommended is None else found.recommended.point


def station_canvas(members: Sequence[tuple[Point, bool]], chosen: Point | None) -> Canvas:
    """The station's plot, for a page or a file.

    Parameters
    ----------
    members : points of the station, and whether each is worth its time; those without a force error are left out.
    chosen : to be ringed; may be None.
    """
    figure = canvas(_HEIGHT_IN)
    axes = figure.add_axes((0.09, 0.13, 0.66, 0.83))
    axes.set_xscale("log")
    axes.set_yscale("log")
    light_grid(axes, "both")
    names = list(dict.fromkeys(point.series for point, _ in members))
    for point, worth in members:
        if "force_error" in point.accuracy:
            _place(axes, point, _COLOURS[names.index(point.series) % len(_COLOURS)], worth)
    if chosen is not None:
        at = (chosen.station_s or 0) / 60, chosen.accuracy["force_error"].value
        axes.plot(*at, "o", color=INK, markersize=10, markerfacecolor="none", markeredgewidth=1.2)
    _plain(axes.xaxis, (10, 15, 20, 30, 45, 60, 90, 120, 180, 240, 360))
    _plain(axes.yaxis, (0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 1, 2, 3, 5))
    axes.set_xlabel("station time a sensor [min]")
    axes.set_ylabel("force error [N]")
    for number, name in enumerate(names):
        colour = _COLOURS[number % len(_COLOURS)]
        axes.text(1.03, 0.97 - 0.06 * number, name, color=colour, transform=axes.transAxes, va="top")
    return figure


def _place(axes: Axes, point: Point, colour: str, worth: bool) -> None:
    minutes, force = (point.station_s or 0) / 60, point.accuracy["force_error"]
    low = min(force.stderr or 0.0, 0.9 * force.value)
    axes.errorbar(minutes, force.value, yerr=[[low], [force.stderr or 0.0]], color=FAINT, linewidth=0.8)
    marker = "s" if point.knobs.get("transients") == "predicted" else "o"
    face = colour if worth else "none"
    axes.plot(minutes, force.value, marker, color=colour, markersize=4, markerfacecolor=face, linestyle="none")
    if point.knobs == PAPER.knobs:
        axes.text(minutes, force.value * 1.12, "paper's campaign ", color=QUIET, fontsize=7, ha="right", va="bottom")


def _plain(axis: Axis, ticks: Sequence[float]) -> None:
    low, high = axis.get_view_interval()
    axis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def write_png(found: "Frontier", path: Path) -> None:
    """Write the station's plot as a picture.

    Raises
    ------
    RefusedError
        If there is nothing to draw, the name is not one of a PNG file, or the file cannot be written.
    """
    check_png(path)
    if not any("force_error" in found.points[k].accuracy for k in found.settings):
        raise RefusedError("there is no force error to draw", remedy="sweep the station's clock")
    try:
        with drawing(), mpl.rc_context({"svg.fonttype": "path"}):
            station_canvas(_station(found), _chosen(found)).savefig(path, dpi=200, metadata={"Software": None})
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error


def _series(found: "Frontier", clock: Clock, series: str) -> Section:
    members = [
        (point, on)
        for point, on in zip(found.points, found.pareto, strict=True)
        if point.clock is clock and point.series == series
    ]
    columns, rows = table_of(members)
    title = f"{'Station' if clock is Clock.STATION else 'Computer'}: {series}"
    blocks: list[Block] = [
        text_table(f"Settings of the series {series}", columns, rows, tuple(range(len(columns) - 1)))
    ]
    if alike := alike_in([point for point, _ in members], found.points):
        blocks.append(Paragraph(f"Alike in all of this table: {alike}.", "note"))
    blocks += [Paragraph(f"{words}.", "note") for words in notes_of([point for point, _ in members])]
    return Section(title, tuple(blocks))


def table_of(members: Sequence[tuple[Point, bool]]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Columns and rows of one series: knobs that differ, figures, cost, and whether it is worth it."""
    points = [point for point, _ in members]
    knobs = shown_knobs(points)
    figures = list(dict.fromkeys(name for point in points for name in point.accuracy))
    rows = [
        (
            *(_knob(point.knobs.get(name)) for name in knobs),
            *(_shown(point.accuracy[name]) if name in point.accuracy else "–" for name in figures),
            _cost(point),
            "•" if on else "",
        )
        for point, on in members
    ]
    names = [_NAMES.get(name, name.replace("_", " ")) for name in figures]
    return [*(unit_column(*_named(name)) for name in knobs), *names, "time", "worth it"], rows


def alike_in(members: Sequence[Point], points: Sequence[Point]) -> str:
    """Knobs that a series' table does not show, because they are alike in it, and that other series set otherwise."""
    shown = shown_knobs(members)
    told = {
        name: value
        for name, value in members[0].knobs.items()
        if name not in shown
        and any(p.clock is members[0].clock and p.knobs.get(name, value) != value for p in points)
    }
    return _knobs(told)


def notes_of(members: Sequence[Point]) -> list[str]:
    """Notes on rows of one table, each with the knobs that name its row; once where it is that of all."""
    notes = {point.note for point in members}
    if len(notes) == 1:
        return [note for note in notes if note]
    shown = shown_knobs(members)
    return [
        f"{_knobs({name: point.knobs.get(name) for name in shown})}: {point.note}" for point in members if point.note
    ]


def shown_knobs(points: Sequence[Point]) -> list[str]:
    """Knobs that differ between points; the first one where none does."""
    knobs = [name for name in points[0].knobs if len({point.knobs.get(name) for point in points}) > 1]
    return knobs or list(points[0].knobs)[:1]


def _knobs(knobs: Mapping[str, Knob | None]) -> str:
    told = ((*_named(name), _knob(value)) for name, value in knobs.items())
    return ", ".join(f"{name} {value} {unit}".rstrip() for name, unit, value in told)


def _named(knob: str) -> tuple[str, str]:
    """Name of a knob in words, and its unit; empty where it has none."""
    name, _, last = knob.rpartition("_")
    words, unit = (name, last) if name and last in _UNITS else (knob, "")
    return words.replace("_", " "), unit


def _knob(value: object) -> str:
    if value is None:  # of another method's knob
        return "–"
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _shown(figure: Accuracy) -> str:
    scale, unit = (100, " %") if figure.unit == "1" and figure.value >= 1e-3 else (1, f" {figure.unit}".rstrip(" 1"))
    stderr = "" if figure.stderr is None else f" ± {scale * figure.stderr:.2g}"
    return f"{scale * figure.value:.3g}{stderr}{unit}"


def _cost(point: Point) -> str:
    if point.station_s is not None:
        return f"{point.station_s / 60:.1f} min"
    seconds = point.compute_s or 0.0
    return (
        f"{1e6 * seconds:.3g} µs"
        if seconds < 1e-3
        else f"{1e3 * seconds:.3g} ms"
        if seconds < 1
        else f"{seconds:.3g} s"
    )
