"""Where the time went, and what accuracy it bought."""

from collections.abc import Iterator, Sequence

from cbsr_qa.analysis.run.fewer_places import MapCost, map_costs
from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.plugin import Block, Figure, Paragraph, PhaseRecord, RunObservation, RunResult, Table
from cbsr_qa.report.draw.metrics import waiting_figure
from cbsr_qa.report.draw.time import Budget, budget_figure, error_figure
from cbsr_qa.report.section import RunSection
from cbsr_qa.report.select import Measured, list_holds, spatial_spreads
from cbsr_qa.report.tables import duration, format_or_dash, number, plural, text_table


class TimeAndAccuracy(RunSection):
    """Section of the time that a run took, and the accuracy of its phases."""

    title = "Time, and what accuracy it bought"

    def blocks(self, result: RunResult) -> Iterator[Block]:
        """Return where the time went and, of an observed run, what each phase bought."""
        budgets: list[Budget] = []
        for title, spent in (("Station", result.record.spent), ("Computing", result.compute_s)):
            if sum(seconds for _, seconds in spent) > 0:
                parts = tuple((name.replace("_", " "), seconds) for name, seconds in spent if seconds > 0)
                budgets.append(Budget(title, parts))
        if not budgets:
            return
        words = (
            f"The sensor occupied the station for {duration(result.record.station_s)}; computing took"
            f" {duration(sum(seconds for _, seconds in result.compute_s))} until this report was rendered."
        )
        yield Paragraph(words)
        caption = "Time by activity, largest first. The cost of a test is its station time."
        yield Figure(caption, words, budget_figure(budgets))
        yield from _draw_decisions(result)
        if result.observation is not None:
            run = result.observation
            yield from (_bought(result, run), *_map_bought(result, run), *_waiting(run))


def _draw_decisions(result: RunResult) -> Iterator[Block]:
    """The force error as it fell from press to press, if the run decided between presses."""
    record = result.record
    known = [made for made in record.decisions if made.expected_N is not None and made.upper_N is not None]
    if not known:
        return
    ends = [(plural(made.pressed, "press", "presses"), made) for made in known if made.ends]
    words = " ".join(f"After {after} of {record.phases[made.phase].name!r} {made.end_words}." for after, made in ends)
    minutes = [made.time_s / 60 for made in known]
    expected, upper = ([getattr(made, name) for made in known] for name in ("expected_N", "upper_N"))
    caption = (
        "Force error against station time, decided after each press: expected over the loads that matter (dots), and"
        " its upper bound."
    )
    yield Figure(caption, words or caption, error_figure(minutes, expected, upper))
    if words:
        yield Paragraph(words)


def _bought(result: RunResult, run: RunObservation) -> Table:
    measured = Measured(result.measurements)
    rows = [_phase_row(phase, run, measured) for phase in run.record.phases]
    columns = ("Phase", "Time", "Presses", "Time per press", "Frames averaged", "E_CoM [mm]", "A_OL [%]")
    caption = "Time and accuracy of each phase: mean ± standard deviation over its presses."
    return text_table(caption, columns, rows, (1, 2, 3, 4, 5, 6))


def _phase_row(phase: PhaseRecord, run: RunObservation, measured: Measured) -> list[str]:
    loads = [load for load in run.loads if load.phase == phase.name]
    seconds = phase.ended_s - phase.started_s
    if not loads:
        return [phase.name, duration(seconds), str(len(phase.loops)), "–", "–", "–", "–"]
    cycle = sum(load.record.rest_end_s - load.record.press_start_s for load in loads) / len(loads)
    counts = sorted({load.steady_frames for load in loads})
    averaged = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    spatial = spatial_spreads(measured, loads)[:2]
    return [phase.name, duration(seconds), str(len(loads)), duration(cycle), averaged, *spatial]


def _map_bought(result: RunResult, run: RunObservation) -> list[Block]:
    """Time and error of the response map, whole and from fewer loads; only if the recipe measures force errors."""
    if not any(m.name == "force_error_sd" for m in result.measurements):
        return []
    costs = map_costs(run, run_force(run))
    if not costs:
        return []
    rows = []
    for cost in costs:
        spent = (str(cost.places), str(cost.loads), duration(cost.station_s))
        # Error at the places left out, unless the noise of their loads explains all of it.
        seen = "below noise" if cost.seen == 0 else _percent(cost.seen)
        rows.append([*spent, _percent(cost.stated), seen, _percent(cost.expected)])
    columns = ("Places", "Loads", "Station time", "Stated error [%]", "At places left out: error [%]", "stated [%]")
    caption = (
        "The map learned from fewer loads: standard error in the calibrated area; at the places left out, its"
        " error (without the noise of the loads there) beside the stated one. Root mean squares over three choices"
        " of places."
    )
    return [Paragraph(_map_words(costs)), text_table(caption, columns, rows, (0, 1, 2, 3, 4, 5))]


def _map_words(costs: Sequence[MapCost]) -> str:
    whole, before = costs[-1], costs[-2]
    words = f"The map of the response took {duration(whole.station_s)} for {plural(whole.loads, 'load')}"
    words += f" at {plural(whole.places, 'place')}; its standard error is {_percent(whole.stated)} %."
    if before.places == whole.places:
        words += f" One load at each place would have taken {duration(before.station_s)}"
        words += f" and given {_percent(before.stated)} %."
    return f"{words} The table shows the same for fewer places, as far apart as possible."


def _percent(value: float | None) -> str:
    return format_or_dash(value, lambda share: number(100 * share, 2))


def _waiting(run: RunObservation) -> Iterator[Figure]:
    for timeline in run.timelines:
        mask = min(range(len(timeline.masks)), key=lambda k: abs(timeline.masks[k] - run.main_mask))
        yield Figure(
            f"Effect of the hold time ({timeline.phase}): error and overlap of single frames against the time held,"
            " mean over the presses, middle half shaded. Where the line is flat, a shorter hold costs no accuracy.",
            "Error and overlap against the time a load was held.",
            waiting_figure(timeline, mask, list_holds(run, timeline.phase)),
        )
