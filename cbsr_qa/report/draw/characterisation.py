"""A material in one dimension: changes against stress and strain, and how it settles (paper: Figs 5 to 8, D.19)."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.characterisation import Characterisation, FittedLine, StrainLevel, StrainSettling
from cbsr_qa.domain.results.relaxation import FitStatus
from cbsr_qa.report.draw.relaxation import relaxation_value
from cbsr_qa.report.draw.style import (
    BLUE,
    DASHED,
    FAINT,
    INK,
    QUIET,
    VERMILION,
    annotate,
    canvas,
    dots,
    draw_svg,
    fit_left,
    note,
    plot,
    spread_labels,
)

_BAND: Final = 1.96  # standard errors to each side of a line: 95 %
_STRAINS: Final = LinearSegmentedColormap.from_list("cbsr_strain", ["#9ecae1", "#2171b5", "#08306b"])


@draw_svg
def lines_figure(characterised: Characterisation) -> Canvas:
    """Draw changes between the pins and under the head against stress and strain, with line and band."""
    figure = canvas(4.3)
    grid = figure.add_gridspec(2, 2, left=0.09, right=0.985, bottom=0.095, top=0.945, hspace=0.5, wspace=0.24)
    left_axes: list[Axes] = []
    rows = (
        ("between the pins", "apparent", characterised.against_stress, characterised.against_strain),
        ("under the head", "local", characterised.local_against_stress, characterised.local_against_strain),
    )
    for row, (place_words, change, against_stress, against_strain) in enumerate(rows):
        stress = plot(figure, grid[row, 0], f"{place_words}, against stress", x="stress [kPa]", y="Δρ/ρ₀ [%]")
        _draw_line(stress, characterised, against_stress, "stress_kPa", change, scale=1.0)
        strain = plot(figure, grid[row, 1], f"{place_words}, against strain", x="strain [%]")
        _draw_line(strain, characterised, against_strain, "strain", change, scale=100.0)
        left_axes.append(stress)
    fit_left(figure, grid, left_axes)
    return figure


def _draw_line(
    axes: Axes,
    characterised: Characterisation,
    line: FittedLine,
    place: str,
    change: str,
    *,
    scale: float,
) -> None:
    """Cycles as faint dots, means with deviations, strains left out open; the line only where it was fitted.

    ``place`` (times ``scale``) and ``change`` are attributes of a cycle, drawn across and up.
    """
    highest = 0.0
    for level in characterised.levels:
        members = [(getattr(c, place), getattr(c, change)) for c in characterised.cycles if c.strain == level.strain]
        points = np.array([(x * scale, 100 * y) for x, y in members if x is not None]).reshape(-1, 2)
        if len(points):
            _draw_level(axes, level, points)
            highest = max(highest, float(points[:, 0].max()))
    if line.line is None or not highest:
        note(axes, 0.98, 0.06, "no line", VERMILION, ha="right")
        return
    slope, intercept = line.line.slope, line.line.intercept
    x = np.linspace(0, 1.06 * highest, 60) / scale
    y = slope.value * x + intercept.value
    variance = ((slope.stderr or 0) * x) ** 2 + (intercept.stderr or 0) ** 2 + 2 * x * (line.line.covariance or 0)
    error = _BAND * np.sqrt(np.maximum(variance, 0))
    band = (100 * (y - error), 100 * (y + error))
    axes.fill_between(x * scale, *band, color=BLUE, alpha=0.14, linewidth=0, zorder=1)
    axes.plot(x * scale, 100 * y, color=BLUE, linewidth=1.1, zorder=2)
    axes.set_xlim(0, 1.06 * highest)


def _draw_level(axes: Axes, level: StrainLevel, points: Array) -> None:
    x, y = points.mean(axis=0)
    deviation = points[:, 1].std(ddof=1) if len(points) > 1 else 0.0
    axes.plot(points[:, 0], points[:, 1], linestyle="none", marker="o", markersize=2, color=FAINT, zorder=2.5)
    dots(axes, x, y, VERMILION if level.why else INK, errors=deviation, hollow=bool(level.why), capsize=2)
    if level.why:
        annotate(axes, f"{100 * level.strain:g} % left out", (x, y), (5, -2), VERMILION, va="top")


@draw_svg
def relaxations_figure(characterised: Characterisation) -> Canvas:
    """Draw the mean trace of every strain after press and release with its fit, over its steady change."""
    signals = (
        ("conductance after the press", _select_settlings(characterised, "conductance", True)),
        ("conductance after the release", _select_settlings(characterised, "conductance", False)),
        ("stress after the press", _select_settlings(characterised, "stress", True)),
    )
    panels = [(title, members) for title, members in signals if members]
    figure = canvas(2.35)
    grid = figure.add_gridspec(1, max(len(panels), 1), left=0.07, right=0.94, bottom=0.18, top=0.88, wspace=0.27)
    for column, (title, members) in enumerate(panels):
        axes = plot(figure, grid[column], title, x="time since the end of the ramp [s]")
        ends = [_draw_relaxation(axes, characterised, settling, len(members)) for settling in members]
        axes.set_xlim(left=0)
        if column == 0:
            axes.set_ylabel("Δρ/ρ₀ [%]")
        if title.startswith("stress"):
            axes.set_ylabel("[kPa]", labelpad=1)
        if column == len(panels) - 1:
            _name_strains(axes, members, ends)
    return figure


def _select_settlings(characterised: Characterisation, signal: str, loading: bool) -> list[StrainSettling]:
    return [
        settling
        for settling in characterised.settlings
        if settling.signal == signal
        and settling.loading is loading
        and settling.strain is not None
        and len(settling.values)
    ]


def _draw_relaxation(axes: Axes, characterised: Characterisation, settling: StrainSettling, count: int) -> float:
    """Draw one strain's mean trace and fit; return where it ends."""
    scale = 100.0 if settling.signal == "conductance" else 1.0
    strains = sorted({level.strain for level in characterised.levels})
    colour = _STRAINS(strains.index(settling.strain or 0.0) / max(count - 1, 1))
    look: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 1.5, "alpha": 0.55, "zorder": 2}
    axes.plot(settling.time_s, scale * settling.values, color=colour, **look)
    if settling.fit.status not in (FitStatus.REJECTED, FitStatus.DRIFTING):
        fine = np.linspace(0.0, float(settling.time_s[-1]), 120)
        axes.plot(fine, scale * relaxation_value(settling.fit, fine), color=colour, linewidth=1.0, zorder=3)
        settled = settling.settling.value_s
        if settled is not None and not settling.settling.censored:
            settled_value = scale * relaxation_value(settling.fit, np.array([settled]))
            axes.plot(
                [settled], settled_value, marker="|", markersize=7, markeredgewidth=1.2, color=VERMILION, zorder=4
            )
    return scale * float(settling.values[-max(len(settling.values) // 8, 1) :].mean())


def _name_strains(axes: Axes, members: Sequence[StrainSettling], ends: Sequence[float]) -> None:
    low, high = axes.get_ylim()
    places = spread_labels(list(ends), 0.075 * (high - low))
    for settling, place in zip(members, places, strict=True):
        x = axes.get_xlim()[1]
        axes.text(1.01 * x, place, f"{100 * (settling.strain or 0):g} %", va="center", fontsize=7, color=QUIET)


@draw_svg
def settling_by_strain_figure(characterised: Characterisation) -> Canvas:
    """Draw settling times against strain, for loading and unloading (paper: Fig D.19)."""
    figure = canvas(2.3)
    grid = figure.add_gridspec(1, 2, left=0.075, right=0.985, bottom=0.18, top=0.88, wspace=0.2)
    for column, signal in enumerate(("conductance", "stress")):
        label = "" if column else "settling time [s]"
        axes = plot(figure, grid[column], f"{signal} settles", x="strain [%]", y=label)
        for loading in (True, False):
            _draw_settling(axes, characterised, signal, loading)
        axes.set_ylim(bottom=0)
    return figure


def _draw_settling(axes: Axes, characterised: Characterisation, signal: str, loading: bool) -> None:
    colour, shift = (BLUE, -0.15) if loading else (VERMILION, 0.15)
    members = [
        settling
        for settling in _select_settlings(characterised, signal, loading)
        if settling.settling.value_s is not None
    ]
    for settling in members:
        strain_and_time = (100 * (settling.strain or 0) + shift, settling.settling.value_s or 0.0)
        symbol, error = "^" if settling.settling.censored else "o", settling.stderr_s or 0.0
        dots(axes, *strain_and_time, colour, errors=error, hollow=not loading, fmt=symbol, capsize=2)
    common = next(
        (o for o in characterised.settlings if (o.signal, o.loading, o.strain) == (signal, loading, None)), None
    )
    if not members or common is None or common.settling.value_s is None:
        return
    value, error = common.settling.value_s, common.stderr_s or 0.0
    axes.axhline(value, color=colour, linewidth=0.8, linestyle="solid" if loading else DASHED, zorder=2)
    axes.axhspan(value - error, value + error, color=colour, alpha=0.1, linewidth=0, zorder=1)
    label = f"after the {'press' if loading else 'release'}, all strains: {value:.3g} s"
    note(axes, 0.99, 0.06 if loading else 0.15, label, colour, ha="right")
