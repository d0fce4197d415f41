"""The runs of a station that are charted, and what is said where there are none."""

from difflib import get_close_matches

from cbsr_qa.app.charts_request import ChartsRequest
from cbsr_qa.app.figure_series import named
from cbsr_qa.config.echo import echo
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.naming import of_kind
from cbsr_qa.domain.run_figures import RunLine
from cbsr_qa.store.figures import RunFilter
from cbsr_qa.store.repository import Repository


def charted_runs(store: Repository, request: ChartsRequest) -> tuple[tuple[RunLine, ...], str]:
    """Return the runs of the station that are charted, and their recipe.

    Raises
    ------
    RefusedError
        If there are none, or they are of several recipes.
    """
    wanted = RunFilter(
        serials=(request.golden,) if request.golden else (),
        station=request.station,
        golden=bool(request.golden),
    )
    lines = store.run_lines(wanted)
    if not lines:
        raise _nothing(store, request)
    here = of_kind("station", request.station)
    recipes = sorted({line.recipe for line in lines})
    if request.recipe is None and len(recipes) > 1:
        raise RefusedError(f"{here} ran {len(recipes)} recipes: {named(recipes)}", remedy="choose one by --recipe")
    recipe = request.recipe or recipes[0]
    if recipe not in recipes:
        near = get_close_matches(recipe, recipes, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise RefusedError(
            f"{here} has no runs of recipe {echo(recipe, 64)}",
            remedy=f"{hint}it ran: {named(recipes)}",
        )
    return tuple(line for line in lines if line.recipe == recipe), recipe


def _nothing(store: Repository, request: ChartsRequest) -> RefusedError:
    stations = sorted({run.station for run in store.find_runs()})
    if request.station not in stations:
        near = get_close_matches(request.station, stations, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"stored: {named(stations) or 'no runs at all'}"
        return RefusedError(f"no run of station {echo(request.station, 64)} is stored", remedy=hint)
    of = f"of sensor {echo(request.golden, 64)}" if request.golden else "of production"
    return RefusedError(
        f"{of_kind('station', request.station)} has no analysed run {of}",
        remedy="golden sensors are charted by --golden SERIAL",
    )
