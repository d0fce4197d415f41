"""How the figures look: the report's type, lines and colours, at the width of a page on a screen."""

import re
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, Colormap
from matplotlib.figure import Figure as Canvas
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator, NullFormatter, StrMethodFormatter

from cbsr_qa.report.draw.style import AMOUNT_MAP, INK, QUIET, light_grid, svg_of
from cbsr_qa.report.svg import check_svg
from simulation_figures.worlds import Array, sensor_type

#: Makes one figure.
Draw = Callable[[], Canvas]

WIDTH_PX: Final = 640
_WIDTH_IN: Final = 5.4  # drawn this wide and shown in WIDTH_PX, type is 12 px high

#: Lines of what a closed form says.
CLOSED: Final[dict[str, Any]] = {"color": INK, "linestyle": (0, (4, 2)), "linewidth": 0.9}
#: Lines of the world without the effect.
WITHOUT: Final[dict[str, Any]] = {"color": QUIET, "linewidth": 1.0}


def panels(*widths: float, height_in: float = 2.05) -> tuple[Canvas, list[Axes]]:
    """An empty figure with axes side by side, this wide compared with each other."""
    figure = Canvas(figsize=(_WIDTH_IN, height_in), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.06, h_pad=0.05, wspace=0.06)  # type: ignore[union-attr, call-arg]
    grid = figure.add_gridspec(1, len(widths), width_ratios=widths)
    return figure, [figure.add_subplot(grid[0, column]) for column in range(len(widths))]


def say(axes: Axes, title: str, x: str, y: str, *, grid: str = "y") -> None:
    """Title and labels of axes, and hairlines behind the data."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if grid:
        light_grid(axes, grid)


def key(axes: Axes, place: str = "best", **options: Any) -> None:
    """A legend without a frame."""
    plain: dict[str, Any] = {"frameon": False, "fontsize": 7, "handlelength": 1.8, "labelspacing": 0.35}
    axes.legend(loc=place, **plain, **options)  # type: ignore[call-overload]


def disc_map(axes: Axes, values_at: Callable[[Array], Array], label: str, *, colours: Colormap = AMOUNT_MAP) -> None:
    """A quantity over the disc in a dozen steps of colour, with outline, pins and a scale."""
    radius_mm = sensor_type().radius_mm
    along = np.linspace(-radius_mm, radius_mm, 121)
    places = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    values = np.where(np.hypot(*places.T) <= radius_mm, values_at(places), np.nan).reshape(121, 121)
    levels = MaxNLocator(10).tick_values(float(np.nanmin(values)), float(np.nanmax(values)))
    edge = radius_mm * (1 + 1 / 120)
    image = axes.imshow(
        values,
        extent=(-edge, edge, -edge, edge),
        origin="lower",
        cmap=colours,
        norm=BoundaryNorm(levels, colours.N),
        interpolation="none",
    )
    scale_beside(axes, image, label)
    outline(axes)


def outline(axes: Axes) -> None:
    """The disc's outline and its pins, in millimetres and equal scale."""
    kind = sensor_type()
    turn = np.linspace(0, 2 * np.pi, 181)
    axes.plot(kind.radius_mm * np.cos(turn), kind.radius_mm * np.sin(turn), color=QUIET, linewidth=0.8)
    axes.plot(*kind.electrodes.positions_mm().T, "o", color=INK, markersize=2)
    axes.set_aspect("equal")
    axes.set(xlabel="x [mm]", ylabel="y [mm]", xticks=(-50, 0, 50), yticks=(-50, 0, 50))
    axes.spines[:].set_visible(False)


def scale_beside(axes: Axes, image: AxesImage, label: str) -> None:
    """A colour scale at the right of axes."""
    figure = axes.figure
    bar = figure.colorbar(image, ax=axes, shrink=0.9, pad=0.03, aspect=16)
    bar.set_label(label)
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=2)


def frame_map(axes: Axes, values: Array, label: str, **options: object) -> None:
    """A quantity of all readings of a frame, drive pairs down, measure pairs across."""
    image = axes.imshow(values, interpolation="none", **options)  # type: ignore[arg-type]
    axes.set(xlabel="measure pair", ylabel="drive pair", xticks=(0, 5, 10, 15), yticks=(0, 5, 10, 15))
    scale_beside(axes, image, label)


def logarithmic(axes: Axes, *, x: bool = False) -> None:
    """Logarithmic axes whose numbers are written out."""
    axes.set_yscale("log")
    if x:
        axes.set_xscale("log")
    for axis in (axes.xaxis, axes.yaxis) if x else (axes.yaxis,):
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def by_electrode(axes: Axes, what: str = "electrode") -> None:
    """Sixteen places across."""
    axes.set_xticks(range(0, 16, 3))
    axes.set_xlim(-0.7, 15.7)
    axes.set_xlabel(what)


def note(axes: Axes, text: str, at: tuple[float, float], **options: object) -> None:
    """A few words inside axes, at a place of the data."""
    axes.annotate(text, at, **{"fontsize": 7, "color": INK, **options})  # type: ignore[arg-type]


def as_file(name: str, draw: Draw) -> str:
    """Draw a figure and return it as an SVG file that is the same however often it is drawn.

    Numbers are rounded, and what is referred to is named by its count: the last digit of a result changes nothing.
    """
    svg = svg_of(draw)
    # Where the typeface is missing, one of the same width; white, since pages may be dark.
    svg = svg.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg)
    assert size is not None
    height_px = round(WIDTH_PX * float(size[2]) / float(size[1]))
    svg = re.sub(r' width="[^"]*"', "", svg, count=1)
    svg = re.sub(r' height="[^"]*"', f' width="{WIDTH_PX}" height="{height_px}"', svg, count=1)
    for count, own in enumerate(dict.fromkeys(re.findall(r'id="([^"]+)"', svg))):
        svg = svg.replace(f'id="{own}"', f'id="n{count}"').replace(f"#{own}", f"#n{count}")
    svg = re.sub(r"<[^>]*>", lambda tag: re.sub(r"\d+\.\d{3,}", _rounded, tag[0]), svg)
    head, end, rest = svg.partition(">")
    return check_svg(f'{head}{end}\n<rect width="100%" height="100%" fill="#ffffff"/>{rest}\n')


def _rounded(number: re.Match[str]) -> str:
    """A hundredth of a point is finer than any screen."""
    return f"{float(number[0]):.2f}".rstrip("0").rstrip(".")
