"""``cbsr-qa frontier --stored``: what fewer presses, shorter holds or the batch as prior would have cost."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from os import cpu_count
from pathlib import Path
from typing import Any, Final, TypeVar

import cbsr_qa
from cbsr_qa.config.merging import restore as restore_configuration
from cbsr_qa.config.paths import database_url, var_folder, writable_folder
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.batch_model import KeptSensor
from cbsr_qa.domain.results.fleet import RunLine, RunSelection
from cbsr_qa.report.tables import plural
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.frontier.files import WRITTEN_BY, check_recipe, write_document
from cbsr_qa.studies.frontier.point import Accuracy, BatchAsPrior, BatchChange, Knob, Point, TimeBasis, restore
from cbsr_qa.studies.frontier.recommend import CONFIDENCE, USUAL_ROOM, Recommendation, Target
from cbsr_qa.studies.frontier.station import mark_worth_of_station
from cbsr_qa.studies.frontier.stored.batch import (
    StoredBatch,
    explain_few_others,
    find_batch,
    learn_others,
    plan_observation,
)
from cbsr_qa.studies.frontier.stored.trial import Design, StoredTrial, Way, plan_trial, read_design
from cbsr_qa.studies.frontier.study import Frontier
from cbsr_qa.studies.selection import check_names, describe_recipes
from cbsr_qa.studies.sweep import Kept, Tell, Work, compute_pieces

FORCE: Final = "force_error"
CHANGE: Final = "force_error_change"
#: Version of the evaluation: pieces of other versions are computed again.
_VERSION: Final = 3
_PROCESSES: Final = min(2, cpu_count() or 1)
#: Fewest sensors for means with intervals, and for a choice that is confirmed on sensors which had no part in it.
_FEWEST_SENSORS: Final = 3
_ENOUGH_TO_CONFIRM: Final = 8
_ATTEMPTS: Final = 3

T = TypeVar("T")

#: Trials of a way, by serial number.
TrialsByWay = Mapping[Way, Mapping[str, StoredTrial]]


def study_stored(
    selection: RunSelection,
    target: Target,
    *,
    database: str | None,
    recipe: Path | None = None,
    fresh: bool = False,
    tell: Tell,
) -> Frontier:
    """Try fewer places, shorter holds and the batch as prior on stored runs, one of each sensor, and choose a way.

    The model of the batch is learned for each sensor from the others alone.

    Finished runs are kept in ``frontier/`` of the var folder.

    Parameters
    ----------
    recipe : file to write the recipe that follows to.
    fresh : discard finished runs.

    Raises
    ------
    RefusedError
        If no run fits, runs are of several recipes or pressed other places, sensors are fewer than three, or there is
        no recipe to write.
    StoreError
        If the database is missing or cannot be read, or a run does not match its chain.
    """
    if recipe is not None:
        check_recipe(recipe)
    url = database_url(database)
    with open_store(url, create=False) as store:
        runs = _choose_runs(store, selection)
        configuration = store.runs.read_configuration(runs[-1].run)
        settings = restore_configuration(configuration).recipe.analysis
        design = read_design(store.runs.load(runs[-1].run), settings)
        batch, why = _find_batch(store, selection, runs)
    kept_file = writable_folder(var_folder() / "frontier") / "stored.jsonl"
    if fresh:
        kept_file.unlink(missing_ok=True)
    compute = Pieces(Kept(kept_file), tell)
    trials = compute.collect(StoredTrial, [(run.run, run.words, plan_trial(url, run.run)) for run in runs])
    prior = BatchAsPrior(0, why)
    if batch is not None:
        with_batch, prior = try_batch(batch, runs, url, compute)
        trials += with_batch
    by_way = _group_trials(trials, design, with_batch=not prior.why)
    points = tuple(make_points(by_way, design))
    prior = replace(prior, changes=tuple(compare_pairs(points)))
    frontier = Frontier(False, points, choose_way(by_way, design, target), batch=prior)
    if recipe is not None:
        write_stored_recipe(frontier.recommended, json.loads(configuration)["recipe"], design, recipe)
        return replace(frontier, recommended=replace(frontier.recommended, recipe=str(recipe)))
    return frontier


class Pieces:
    """Work on stored runs in several processes, kept when done."""

    def __init__(self, kept: Kept, tell: Tell) -> None:
        self._kept, self._tell = kept, tell

    def collect(self, kind: type[T], work: Sequence[tuple[str, str, Callable[[], list[T]]]]) -> list[T]:
        """Return the results of work with its key, its words, and what does it."""
        version = f"stored {_VERSION}/{cbsr_qa.__version__}"
        pieces = [Work(f"{version}/{key}", words, run) for key, words, run in work]
        done = compute_pieces(pieces, self._kept, self._tell, processes=_PROCESSES)
        return [restore(kind, document) for documents in done.values() for document in documents]


def _find_batch(
    store: Repository, selection: RunSelection, runs: Sequence[RunLine]
) -> tuple[StoredBatch | None, str]:
    """The batch of the runs; None with the reason if its model cannot be learned without each of them."""
    try:
        return find_batch(store, selection, runs), ""
    except RefusedError as refusal:
        return None, refusal.reason


def try_batch(
    batch: StoredBatch, runs: Sequence[RunLine], url: str, compute: Pieces
) -> tuple[list[StoredTrial], BatchAsPrior]:
    """Try the batch as prior: each sensor with the model of the others; none if too few of them say anything."""
    observations = [(f"{run}/loads", serial, plan_observation(url, run)) for serial, run in batch.runs]
    sensors = compute.collect(KeptSensor, observations)
    why = explain_few_others([sensor.serial for sensor in sensors], runs)
    if why:
        return [], BatchAsPrior(len(sensors), why)
    models = learn_others(batch, sensors, [run.serial for run in runs])
    with_models = [(run, models[run.serial]) for run in runs]
    work = [
        (f"{run.run}/{model.content_sha256}", run.words, plan_trial(url, run.run, model))
        for run, model in with_models
    ]
    return compute.collect(StoredTrial, work), BatchAsPrior(len(sensors))


def _choose_runs(store: Repository, selection: RunSelection) -> list[RunLine]:
    """The latest finished run of each sensor, all of one recipe."""
    lines = [line for line in store.fleet.read_lines(selection) if line.finished and not line.altered]
    if not lines:
        check_names(store, selection)
        raise RefusedError("no finished run fits", remedy="choose other days or names")
    recipes = {line.recipe for line in lines}
    if len(recipes) > 1:
        raise RefusedError(f"these runs are of {describe_recipes(recipes)}", remedy="choose one by --of-recipe")
    latest = {line.serial: line for line in lines}
    if len(latest) < _FEWEST_SENSORS:
        raise RefusedError(
            f"these runs are of {plural(len(latest), 'sensor')}, which do not show how sensors scatter",
            remedy=f"choose runs of at least {_FEWEST_SENSORS} sensors",
        )
    return sorted(latest.values(), key=lambda line: line.run)


def _group_trials(trials: Sequence[StoredTrial], design: Design, *, with_batch: bool) -> TrialsByWay:
    """Trials of each way; RefusedError if runs pressed other places or held them for another time."""
    ways = [*design.list_ways(), *(design.list_batch_ways() if with_batch else ())]
    by_way: dict[Way, dict[str, StoredTrial]] = {way: {} for way in ways}
    for trial in trials:
        if trial.way not in by_way:
            raise RefusedError(
                f"run {trial.run} pressed other places than the latest, or held them for another time",
                remedy="choose days on which the recipe was the same, by --since and --until",
            )
        by_way[trial.way][trial.serial] = trial
    return by_way


def make_points(by_way: TrialsByWay, design: Design) -> list[Point]:
    """Return the point of each way, and mark which are worth their time."""
    whole = by_way[design.whole]
    points = [_make_point(way, trials, whole, sorted(trials)) for way, trials in by_way.items()]
    return mark_worth_of_station(points)


def compare_pairs(points: Sequence[Point]) -> Iterator[BatchChange]:
    """Compare each way that has the batch as prior with the same way without."""
    for point in points:
        if point.knobs["prior"] == "batch":
            without = next(other for other in points if other.knobs == {**point.knobs, "prior": "none"})
            if FORCE in point.accuracy and FORCE in without.accuracy:
                yield BatchChange.from_pair(point.knobs, without.accuracy[FORCE], point.accuracy[FORCE])


def _make_point(
    way: Way, trials: Mapping[str, StoredTrial], whole: Mapping[str, StoredTrial], serials: Sequence[str]
) -> Point:
    """Mean error of a way over some sensors, and its change from the whole run in pairs."""
    refusals = [trials[serial].why for serial in serials if trials[serial].why]
    errors = [trials[serial].force_error_N for serial in serials]
    wholes = [whole[serial].force_error_N for serial in serials]
    known = [error for error in errors if error is not None]
    pairs = [
        (own, all_of) for own, all_of in zip(errors, wholes, strict=True) if own is not None and all_of is not None
    ]
    accuracy = {}
    if len(known) == len(serials):
        accuracy[FORCE] = Accuracy.from_sensors(known, "N")
    if len(pairs) == len(serials):
        accuracy[CHANGE] = Accuracy.from_sensors([own - all_of for own, all_of in pairs], "N")
    note = f"refused on {len(refusals)} of {len(serials)} sensors: {refusals[0]}" if refusals else ""
    station_s = sum(trials[serial].station_s for serial in serials) / len(serials)
    series = "stored runs" if way.prior == "none" else "batch as prior"
    return Point(TimeBasis.STATION, series, way.knobs, accuracy, None, station_s, len(serials), note)


def choose_way(by_way: TrialsByWay, design: Design, target: Target) -> Recommendation:
    """Choose the fastest way whose mean force error is small enough with a confidence of 90 %.

    Small enough: below the target; without one, at most 1.2 times that of the most accurate way, in pairs. With a
    budget the way must take no longer. The batch is taken only where its interval over all sensors shows a gain. From
    eight sensors on, every second one chooses and the others confirm; the
    error stated is theirs.
    """
    whole = by_way[design.whole]
    serials = sorted(whole)
    confirms = len(serials) >= _ENOUGH_TO_CONFIRM
    choosing, confirming = (serials[::2], serials[1::2]) if confirms else (serials, serials)

    def points_of(chosen: Sequence[str]) -> dict[Way, Point]:
        return {way: _make_point(way, trials, whole, chosen) for way, trials in by_way.items()}

    chosen_points, confirmed_points = points_of(choosing), points_of(confirming)
    limit = _describe_limit(target)

    gains = _list_gains(make_points(by_way, design))
    usable = [way for way in by_way if way.prior == "none" or way.knobs in gains]
    tried = [way for way in usable if FORCE in chosen_points[way].accuracy]
    if not tried:
        return Recommendation(
            None, None, None, f"every way is refused on a sensor: {chosen_points[design.whole].note}"
        )
    best = min(tried, key=lambda way: chosen_points[way].accuracy[FORCE].value)

    def suffices(way: Way, points: Mapping[Way, Point]) -> bool:
        return _is_small_enough(points[way], points[best], target)

    candidates = [way for way in usable if suffices(way, chosen_points)]
    candidates.sort(key=lambda way: chosen_points[way].station_s or 0.0)
    for way in candidates[:_ATTEMPTS]:
        point = confirmed_points[way]
        if suffices(way, confirmed_points):
            others = f"and again on {len(confirming)} others, whose error is stated" if confirms else "that chose it"
            why = f"the fastest of {len(by_way)} ways with {limit}, on {plural(len(choosing), 'sensor')} {others}"
            return Recommendation(point.knobs, point.accuracy, point.station_s, why, seeds=point.seeds)
    return Recommendation(None, None, None, f"none of {len(by_way)} ways has {limit}")


def _list_gains(points: Sequence[Point]) -> list[Mapping[str, Knob]]:
    """Settings with the batch as prior that are shown to be more accurate than the same without."""
    return [
        {"places": change.places, "hold_s": change.hold_s, "transients": change.transients, "prior": "batch"}
        for change in compare_pairs(points)
        if change.high_N < 0
    ]


def _describe_limit(target: Target) -> str:
    limit = f"at most {USUAL_ROOM:g} times the force error of the most accurate"
    if target.force_error_N is not None:
        limit = f"a mean force error below {target.force_error_N:g} N"
    within = "" if target.budget_s is None else f" within {target.budget_s / 60:g} min"
    return f"{limit}{within} with {100 * CONFIDENCE:g} % confidence"


def _is_small_enough(point: Point, best: Point, target: Target) -> bool:
    if FORCE not in point.accuracy or FORCE not in best.accuracy:
        return False
    if target.budget_s is not None and (point.station_s or 0.0) > target.budget_s:
        return False
    if target.force_error_N is not None:
        bound, most = point.accuracy[FORCE].upper_bound(CONFIDENCE), target.force_error_N
    else:
        bound, most = point.accuracy[FORCE].subtract(best.accuracy[FORCE], USUAL_ROOM).upper_bound(CONFIDENCE), 0.0
    return bound is not None and bound <= most


def write_stored_recipe(recommended: Recommendation, document: Mapping[str, Any], design: Design, path: Path) -> None:
    """Write the runs' recipe with the places and holds of the chosen way.

    RefusedError if no way was chosen, or a phase that calibrates states neither places nor holds.
    """
    if recommended.setting is None or recommended.accuracy is None:
        raise RefusedError(f"there is no recipe to write: {recommended.why}")
    places, hold_s = int(recommended.setting["places"]), recommended.setting["hold_s"]
    kept = [list(place) for place in design.choose_places(places)]
    calibrate = document["recipe"]["calibrate_phases"]
    phases = []
    for phase in document["phases"]:
        if phase["name"] in calibrate:
            if phase["sequence"] != "location-grid" or len(calibrate) > 1:
                raise RefusedError(
                    f"phase {phase['name']!r} is not the only grid that calibrates: no recipe follows from it",
                    remedy="take the setting from the table",
                )
            phase = {**phase, "locations_mm": kept, "hold_s": hold_s}  # noqa: PLW2901
        phases.append(phase)
    recipe = {**document, "recipe": {**document["recipe"], "name": path.stem[:64]}, "phases": phases}
    chosen = {name: recommended.setting[name] for name in ("transients", "prior")}
    recipe["analysis"] = {**document.get("analysis", {}), **chosen}
    force = recommended.accuracy[FORCE]
    needs = ("It needs a model of the sensor's batch: cbsr-qa batch model.",) if chosen["prior"] == "batch" else ()
    comments = (
        f"{WRITTEN_BY} {cbsr_qa.__version__} --stored: {recommended.why}.",
        f"Mean force error of {plural(recommended.seeds, 'sensor')} {force.value:.3f} ± {force.stderr or 0.0:.3f} N,"
        f" {(recommended.station_s or 0) / 60:.0f} min.",
        *needs,
    )
    write_document(path, recipe, comments)
