"""One look for all figures, readable without colour and in grey, and the way from a figure to a safe inline SVG."""

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any, Final, ParamSpec, cast

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure as Canvas
from matplotlib.gridspec import GridSpec, SubplotSpec
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import ArrayLike

from cbsr_qa.report.svg import rename_own, strip_document

P = ParamSpec("P")
#: Left, bottom, width and height as fractions of a figure.
Box = tuple[float, float, float, float]

INK: Final = "#1c1c1c"
QUIET: Final = "#6a6a6a"
FAINT: Final = "#b9b9b9"
HAIR: Final = "#e2e2e2"

#: Okabe & Ito 2008, told apart with every common colour blindness.
BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#8E5BA6"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
CYCLE: Final = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)

#: An ordered quantity (25, 50, 75, 85 %): light to dark, so that it survives a grey printer.
ORDERED: Final = ("#9ecae1", "#56a0d3", "#2171b5", "#08306b")

#: Text width of an A4 page with the report's margins [in].
WIDTH_IN: Final = 6.9

#: Colour of lines of secondary importance.
DASHED: Final = (0, (4, 2))

#: Width that is kept clear at a figure's left edge [in].
_MARGIN_IN: Final = 0.03

#: Conductance falls (orange-brown), nothing (white), rises (blue).
CHANGE_MAP: Final = LinearSegmentedColormap.from_list(
    "cbsr_change", ["#5d2b02", "#b35806", "#f1a340", "#fde7c8", "#ffffff", "#d6e6f2", "#74add1", "#2166ac", "#072a5c"]
)

#: Little (pale) to much (dark).
AMOUNT_MAP: Final = LinearSegmentedColormap.from_list(
    "cbsr_amount", ["#f4f8fb", "#c6dbef", "#74a9cf", "#2b79b5", "#08306b"]
)

_SETTINGS: Final[dict[str, Any]] = {
    "svg.fonttype": "none",  # text stays text: searchable, and drawn in the page's own typeface
    "svg.hashsalt": "cbsr-qa",  # the same numbers give the same bytes
    "font.family": ["DejaVu Sans"],  # ships with matplotlib; wider than the page's face, so nothing overlaps
    "font.size": 7.5,
    "axes.titlesize": 8,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 5,
    "axes.titley": 1.0,  # not looked for: no figure has ticks at its top
    "axes.labelsize": 7.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": QUIET,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.unicode_minus": True,
    "axes.formatter.use_mathtext": False,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-4, 5),
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 1.0,
    "lines.solid_capstyle": "round",
    "patch.linewidth": 0.6,
    "text.color": INK,
    "text.parse_math": False,  # a serial number with $ in it is not a formula
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "path.simplify": True,
    "path.simplify_threshold": 0.1,
    "image.interpolation": "none",
}


@contextmanager
def drawing() -> Iterator[None]:
    """Apply the shared settings while a figure is built and written."""
    with mpl.rc_context(cast(Any, _SETTINGS)):  # the stubs want literal keys
        yield


def canvas(height_in: float, width_in: float = WIDTH_IN) -> Canvas:
    """Return an empty figure of the page's width."""
    return Canvas(figsize=(width_in, height_in))


def change_norm(largest: float) -> Normalize:
    """Return a symmetric scale around no change; ``largest`` 0 is drawn as one part per million."""
    limit = largest if largest > 0 else 1e-6
    return Normalize(-limit, limit)


def light_grid(axes: Axes, which: str = "y") -> None:
    """Draw hairlines behind the data."""
    axes.grid(True, axis=which, color=HAIR, linewidth=0.5)  # type: ignore[arg-type]
    axes.set_axisbelow(True)


def plot(
    figure: Canvas, place: Box | SubplotSpec, title: str = "", *, x: str = "", y: str = "", grid: str = "y"
) -> Axes:
    """Add axes with hairlines behind the data.

    Parameters
    ----------
    place : left, bottom, width and height as fractions of the figure; or a cell of a grid.
    title, x, y : over the axes and along them.
    grid : ``"x"``, ``"y"`` or ``"both"``.
    """
    axes = figure.add_subplot(place) if isinstance(place, SubplotSpec) else figure.add_axes(place)
    light_grid(axes, grid)
    axes.set_title(title, fontweight="normal")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    return axes


def place_plain_ticks(axis: Axis, ticks: Sequence[float], text: Callable[[float], str] = "{:g}".format) -> None:
    """Place ticks of a logarithmic axis at those of the values that it shows, written as plain numbers."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))


def note(axes: Axes, x: float, y: float, text: str, colour: str = INK, **look: Any) -> None:
    """Write a note at fractions of the axes; ``look`` as matplotlib's text takes it."""
    options: dict[str, Any] = {"color": colour, "fontsize": 7} | look
    axes.text(x, y, text, transform=axes.transAxes, **options)


def annotate(
    axes: Axes, text: str, at: tuple[float, float], shift: tuple[float, float], colour: str = INK, **look: Any
) -> None:
    """Write a note beside a place of the data, ``shift`` points away."""
    options: dict[str, Any] = {"color": colour, "fontsize": 7} | look
    axes.annotate(text, at, shift, textcoords="offset points", **options)


def dots(
    axes: Axes,
    x: ArrayLike,
    y: ArrayLike,
    colour: str,
    *,
    errors: ArrayLike | None = None,
    size: float = 4.0,
    hollow: bool = False,
    **look: Any,
) -> None:
    """Draw values as dots with error bars along y."""
    face = "white" if hollow else colour
    options: dict[str, Any] = {
        "markersize": size,
        "markerfacecolor": face,
        "elinewidth": 0.9,
        "zorder": 3,
        "fmt": "o",
    } | look
    axes.errorbar(x, y, yerr=errors, color=colour, **options)


def fit_left(figure: Canvas, grid: GridSpec, labelled: Sequence[Axes]) -> None:
    """Align the labels of vertical axes clear of their numbers, and widen the left margin until both have room.

    ``labelled`` is the first column of the grid, drawn in full: numbers decide how wide they are.
    """
    figure.align_ylabels(labelled)
    boxes = [axes.yaxis.get_tightbbox(None) for axes in labelled]
    outermost = min((box.x0 for box in boxes if box is not None), default=0.0)
    missing_share = (_MARGIN_IN * figure.dpi - outermost) / figure.bbox.width
    if missing_share <= 0:
        return
    grid.update(left=grid.get_subplot_params(figure).left + missing_share)
    for axes in figure.axes:  # a grid only moves the axes of figures that pyplot knows
        place = axes.get_subplotspec()
        if place is not None and place.get_gridspec() is grid:
            axes.set_position(place.get_position(figure))


def name_rows(axes: Axes, names: Sequence[str], most: int = 34) -> None:
    """Name the rows of a dot plot, the first on top. If the names do not fit, write every second, third …."""
    every = -(-len(names) // most)
    rows = range(0, len(names), max(every, 1))
    axes.set_yticks(rows, [names[row] for row in rows])
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def bare(axes: Axes) -> None:
    """Remove everything of the axes except their content, in equal scale."""
    axes.set_axis_off()
    axes.set_aspect("equal")


def spread_labels(places: list[float], gap: float) -> list[float]:
    """Move labels at least ``gap`` apart along one axis, keeping their order and their mean."""
    order = sorted(range(len(places)), key=lambda i: places[i])
    spread_places = [places[i] for i in order]
    for _ in range(50 * len(spread_places)):
        pushed = False
        for lower in range(len(spread_places) - 1):
            missing_gap = gap - (spread_places[lower + 1] - spread_places[lower])
            if missing_gap > 1e-9 * max(gap, 1e-300):
                spread_places[lower] -= missing_gap / 2
                spread_places[lower + 1] += missing_gap / 2
                pushed = True
        if not pushed:
            break
    places_in_order = [0.0] * len(places)
    for rank, index in enumerate(order):
        places_in_order[index] = spread_places[rank]
    return places_in_order


def draw_svg(build: Callable[P, Canvas]) -> Callable[P, str]:
    """Make a function that builds a figure return its ``<svg>`` element, drawn under the shared settings."""

    @wraps(build)
    def svg(*arguments: P.args, **options: P.kwargs) -> str:
        return svg_of(lambda: build(*arguments, **options))

    return svg


def svg_of(build: Callable[[], Canvas]) -> str:
    """Build a figure under the shared settings and return its ``<svg>`` element."""
    with drawing():
        figure = build()
        for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
            if not axis.label.get_text():  # no room is looked for beside the numbers
                axis.set_label_coords(0.5, 0.5)
        buffer = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing)
    return rename_own(strip_document(buffer.getvalue()))
