"""The runs of a gauge study, and what is said where they are not there."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from cbsr_qa.app.figure_series import clock_notes, named
from cbsr_qa.app.gauge_request import GaugeRequest
from cbsr_qa.config.echo import echo
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.naming import of_kind
from cbsr_qa.domain.run_figures import RunLine
from cbsr_qa.report.numbers import plural
from cbsr_qa.store.figures import RunFilter
from cbsr_qa.store.repository import Repository


@dataclass(frozen=True, slots=True)
class _Named:
    """One name of a request.

    Parameters
    ----------
    noun : what it is of.
    at : where it stands in the study's file.
    there : whether a run that fits has it.
    """

    noun: str
    name: str
    at: str
    there: bool


def appraiser_of(line: RunLine, kind: str) -> str:
    """Return who or what appraised a run: its station or its operator."""
    return line.station if kind == "station" else line.operator


def chosen_runs(store: Repository, request: GaugeRequest) -> tuple[tuple[RunLine, ...], tuple[str, ...]]:
    """Return the runs of a study, and what is to be said of them all.

    Raises
    ------
    RefusedError
        If none fits, a name is of no run (with the nearest one), or they are of several recipes.
    """
    of_names = store.run_lines(RunFilter(serials=request.serials, recipe=request.recipe))
    lines = tuple(line for line in of_names if request.takes(line))
    _check_found(store, request, of_names, lines)
    recipes = sorted({line.recipe for line in lines})
    if len(recipes) > 1:
        raise RefusedError(
            f"{request.at('study')}these runs are of {len(recipes)} recipes: {named(recipes)}",
            remedy="choose one by its name: recipe in the study, or --recipe",
        )
    nobody = [line for line in lines if not appraiser_of(line, request.appraiser)]
    lines = tuple(line for line in lines if appraiser_of(line, request.appraiser))
    if not lines:
        raise RefusedError(f"none of these runs names its {request.appraiser}", remedy="study stations instead")
    notes = clock_notes(lines)
    if nobody:
        notes += (f"left out: {plural(len(nobody), 'run')} without the name of the {request.appraiser}",)
    return lines, notes


def _check_found(
    store: Repository, request: GaugeRequest, of_names: Sequence[RunLine], lines: Sequence[RunLine]
) -> None:
    """Refuse names without a run, each with its line in the study's file; unknown names come first."""
    absent = [one for one in _names(request, lines) if not one.there]
    if lines and not absent:
        return
    stored = store.run_lines(RunFilter())
    known: dict[str, set[str]] = {
        "recipe": {run.recipe for run in stored},
        "sensor": {run.serial for run in stored},
        "station": {run.station for run in stored},
        "operator": {run.operator for run in stored},
    }
    unknown = [one for one in absent if one.name not in known[one.noun]]
    if unknown:
        said = [f"{one.at}no analysed run is of {one.noun} {echo(one.name, 64)}" for one in unknown]
        raise RefusedError("\n".join(said), remedy=_hint(unknown[0].name, known[unknown[0].noun]))
    remedy = f"choose other days, other names or another recipe{_days(of_names)}"
    # Without any run that fits, every name is absent, and it is no name that is wrong.
    if lines:
        said = [f"{one.at}{of_kind(one.noun, one.name)} has no analysed run that fits" for one in absent]
        raise RefusedError("\n".join(said), remedy=remedy)
    raise RefusedError(f"{request.at('study')}no analysed run fits this study", remedy=remedy)


def _names(request: GaugeRequest, lines: Sequence[RunLine]) -> Iterator[_Named]:
    if request.recipe is not None:
        yield _Named("recipe", request.recipe, request.at("study", "recipe"), bool(lines))
    for noun, key, wanted, there in (
        ("sensor", "serials", request.serials, {line.serial for line in lines}),
        ("station", "stations", request.stations, {line.station for line in lines}),
        ("operator", "operators", request.operators, {line.operator for line in lines}),
    ):
        for name in wanted:
            yield _Named(noun, name, request.at("study", key), name in there)


def _days(lines: Sequence[RunLine]) -> str:
    """Say when runs of the sensors and the recipe were begun, whatever the days and stations; empty without any."""
    days = sorted(line.day for line in lines)
    return f"; runs of its sensors and recipe began from {days[0]} to {days[-1]}" if days else ""


def _hint(name: str, known: Collection[str]) -> str:
    near = get_close_matches(name, known, n=1)
    return f"did you mean {near[0]!r}?" if near else "cbsr-qa db status shows which database is used"
