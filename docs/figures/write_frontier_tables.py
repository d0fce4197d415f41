"""Write docs/reference/frontier.md, the tables of what accuracy costs.

``cbsr-qa frontier --json > frontier.json`` measures everything; ``python docs/figures/write_frontier_tables.py
frontier.json`` puts its tables between the page's markers, ``<!-- table: series -->`` and ``<!-- end -->``. Tables of
series that are not in the file stay as they are. Without a file the computer's sweep is measured (about two minutes);
run it with OMP_NUM_THREADS=1 on a machine that does nothing else.
"""

import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cbsr_qa.studies.frontier.computer.sweeps import mark_worth_of_computer, plan_computer_work
from cbsr_qa.studies.frontier.figures import draw_station
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis, restore
from cbsr_qa.studies.frontier.recommend import Recommendation
from cbsr_qa.studies.frontier.report import tabulate_points
from cbsr_qa.studies.frontier.station import mark_worth_of_station

PAGE: Final = Path(__file__).resolve().parents[1] / "reference" / "frontier.md"
FIGURE: Final = PAGE.parents[1] / "explanation" / "figures" / "frontier" / "station.svg"

_TABLE: Final = re.compile(r"(<!-- table: (.+?) -->\n).*?(<!-- end -->)", re.S)
#: Of methods and smoothing the page shows all λ of one method, and of the others their own choice.
_SHOWN_WHOLE: Final = "gauss-newton-laplace"
#: Figures in the order of their columns.
_FIGURES: Final = {
    "voltage_error": "voltage error",
    "voltage_error_inclusion": "with inclusion",
    "load_signal_error": "error of a load's signal",
    "image_error": "error of the image",
    "E_CoM": "E_CoM",
    "A_OL": "A_OL",
    "SD": "SD",
    "missed": "loads missed",
}
_NAMES: Final = {
    "element_order": "order",
    "element_size_mm": "size [mm]",
    "image_size_mm": "image size [mm]",
    "smoothing_over_own": "λ over own",
    "batch": "frames in a block",
    **_FIGURES,
}
_SAID_ELSEWHERE: Final = frozenset({"noise_figure", "exponent"})


def written(page: str, points: Sequence[Point]) -> str:
    """The page with its tables replaced."""

    def table(found: re.Match[str]) -> str:
        own = [point for point in points if point.series == found[2]]
        chosen = [point for point in own if _shown(point)]
        if not chosen:
            return found[0]
        if chosen[0].clock is TimeBasis.STATION:
            return f"{found[1]}\n{_rows(*tabulate_points(chosen))}\n\n{found[3]}"
        return f"{found[1]}\n{_table(chosen)}\n\n{found[3]}"

    return _TABLE.sub(table, page)


def _shown(point: Point) -> bool:
    if "smoothing_over_own" not in point.knobs:
        return True
    return bool(point.pareto) or point.knobs["smoothing_over_own"] == 1.0 or point.knobs["method"] == _SHOWN_WHOLE


def _table(points: Sequence[Point]) -> str:
    columns = {"": [""] * len(points)}
    for name in points[0].knobs:
        if name not in _SAID_ELSEWHERE:
            columns[_NAMES.get(name, name)] = [_knob(point, name) for point in points]
    for name in sorted({name for point in points for name in point.accuracy}, key=_place):
        columns[_NAMES.get(name, name)] = [_figure(point.accuracy.get(name)) for point in points]
    columns["unknowns"] = [f"{point.costs['unknowns']:.0f}" for point in points]
    columns["set-up"] = [_seconds(point.costs.get("setup_s")) for point in points]
    columns["memory"] = [_megabytes(point.costs.get("memory_bytes")) for point in points]
    columns["time"] = [_seconds(point.compute_s) for point in points]
    shown = {name: cells for name, cells in columns.items() if len(set(cells)) > 1}
    shown["•"] = ["•" if point.pareto else "" for point in points]
    return _rows(list(shown), list(zip(*shown.values(), strict=True)))


def _rows(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    every = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(row)} |".replace("|  |", "| |") for row in every)


def _place(name: str) -> int:
    return list(_FIGURES).index(name)


def _knob(point: Point, name: str) -> str:
    value = point.knobs[name]
    if name == "method" and "exponent" in point.knobs:
        return f"{value}, exponent {point.knobs['exponent']}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _figure(accuracy: Accuracy | None) -> str:
    if accuracy is None:
        return "–"
    if accuracy.unit == "1" and accuracy.stderr is None:
        return f"{accuracy.value:.1e}"
    if accuracy.unit == "1":
        return f"{100 * accuracy.value:.0f} %"
    digits = 1 if accuracy.unit == "%" else 2
    sure = "" if accuracy.stderr is None else f" ± {accuracy.stderr:.{digits}f}"
    return f"{accuracy.value:.{digits}f}{sure} {accuracy.unit}"


def _seconds(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} µs"


def _megabytes(size: float | None) -> str:
    return "–" if size is None else f"{size / 1e6:.1f} MB"


def main(arguments: Sequence[str]) -> None:
    """Take points from a file, or measure them, and write the page."""
    if arguments:
        documents = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))["points"]
        points = [restore(Point, document) for document in documents]
    else:
        points = []
        for work in plan_computer_work():
            sys.stderr.write(f"{work.what}\n")
            points += work.run()
    computer, station = (
        [point for point in points if point.clock is clock] for clock in (TimeBasis.COMPUTER, TimeBasis.STATION)
    )
    points = [*mark_worth_of_computer(computer), *mark_worth_of_station(station)]
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8"), points), encoding="utf-8")
    if station:
        FIGURE.parent.mkdir(exist_ok=True)
        FIGURE.write_text(draw_station(points, Recommendation(None, None, None, "")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
