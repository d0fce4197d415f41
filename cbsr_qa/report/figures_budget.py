"""Where the time went."""

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from cbsr_qa.domain.report import Figure
from cbsr_qa.report.numbers import duration
from cbsr_qa.report.style import BLUE, canvas
from cbsr_qa.report.svg import drawn


@dataclass(frozen=True, slots=True)
class Budget:
    """A total and its parts, in seconds."""

    title: str
    parts: tuple[tuple[str, float], ...]


def budget_figure(budgets: Sequence[Budget], *, caption: str, alternative: str) -> Figure:
    """Draw one panel of bars per budget, the largest part first, each bar with its time and share."""

    def build() -> Canvas:
        rows = max(len(budget.parts) for budget in budgets)
        height_in = 0.19 * rows + 0.42
        figure = canvas(height_in)
        width = 1 / len(budgets)
        for column, budget in enumerate(budgets):
            share = len(budget.parts) / rows
            top = 1 - 0.3 / height_in
            height = (0.19 * rows / height_in) * share
            axes = figure.add_axes((column * width + 0.15, top - height, width - 0.29, height))
            _draw_bars(axes, budget)
        return figure

    return drawn(build, caption=caption, alternative=alternative)


def _draw_bars(axes: Axes, budget: Budget) -> None:
    parts = sorted(budget.parts, key=lambda part: -part[1])
    total = sum(seconds for _, seconds in parts)
    axes.barh(range(len(parts)), [seconds for _, seconds in parts], height=0.68, color=BLUE, linewidth=0)
    for row, (_, seconds) in enumerate(parts):
        share = f"  ({100 * seconds / total:.0f} %)" if total else ""
        told = f"{duration(seconds)}{share}"
        axes.annotate(told, (seconds, row), (3, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(range(len(parts)), [name for name, _ in parts])
    axes.set_ylim(len(parts) - 0.5, -0.5)
    axes.set_xticks([])
    axes.tick_params(axis="y", length=0)
    for side in ("bottom", "left"):
        axes.spines[side].set_visible(False)
    axes.set_title(f"{budget.title}: {duration(total)}", x=0, pad=3)
