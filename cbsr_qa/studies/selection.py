"""Runs selected for a study: refused names, and differences between compared runs."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from itertools import pairwise
from typing import Any, Final

from cbsr_qa.config.merging import canonical_json
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import did_you_mean, prefix_kind
from cbsr_qa.domain.results.fleet import CalibrationWay, KnownNames, RunLine, RunSelection
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.words import echo

#: Reason of a failure that no limit gave: an operator decided it.
BY_OPERATOR: Final = "decided by an operator"
#: Runs may be stored slightly out of order of their start; beyond this a clock was wrong.
_CLOCK_STEP: Final = timedelta(days=1)
#: Tables of a recipe that affect judgement or display, but no number.
_NOT_MEASURING: Final = ("limits", "limits_version", "failure_codes", "report")
#: Number of known names in a remedy.
_MAX_LISTED_NAMES: Final = 20
#: Selection criteria of runs: noun, field of the selection, field of the known names.
_NAMES: Final = (
    ("recipe", "recipe", "recipes"),
    ("batch", "batch", "batches"),
    ("sensor", "serials", "serials"),
    ("station", "stations", "stations"),
    ("operator", "operators", "operators"),
)
_OTHER_DATABASE: Final = "cbsr-qa db status shows which database is used"


@dataclass(frozen=True, slots=True)
class WayCount:
    """A way in which calibrations were made, and the number of runs."""

    way: CalibrationWay
    runs: int


def nearest(name: str, known: Collection[str], there_are: str) -> str:
    """Remedy for an unknown name: the nearest one, and the known ones."""
    all_names = f"{there_are}: {list_names(sorted(known), _MAX_LISTED_NAMES)}" if known else _OTHER_DATABASE
    return f"{did_you_mean(name, known)} {all_names}".lstrip()


def missing_metric_error(name: str, known: Collection[str], at: str = "") -> RefusedError:
    """Return the refusal of a metric that no run of a study measured."""
    return RefusedError(f"{at}no run of these measured {echo(name, 64)}", remedy=nearest(name, known, "measured"))


def absent_names(selection: RunSelection, known: KnownNames) -> Iterator[tuple[str, str, str, Collection[str]]]:
    """Yield names of a selection without runs: noun, field of the selection, name, known names."""
    for noun, field, known_field in _NAMES:
        selected = getattr(selection, field)
        known_names = getattr(known, known_field) - {""}
        for name in (selected,) if isinstance(selected, str) else selected or ():
            if name not in known_names:
                yield noun, field, name, known_names
    for selected_part in selection.parts:
        if not any(map(selected_part.selects, known.parts)):
            # The letters of a revision that was not asked for would decide which lot is near.
            known_parts = {part if selected_part.revision else replace(part, revision="") for part in known.parts}
            yield "part", "parts", str(selected_part), {str(part) for part in known_parts}


def check_names(store: Repository, selection: RunSelection, at: Callable[[str], str] = lambda field: "") -> None:
    """Refuse all names of a selection without stored runs, with the name nearest to the first.

    Parameters
    ----------
    at : position of a selection's field in a file, at the beginning of the message.
    """
    absent_entries = list(absent_names(selection, store.fleet.read_known_names()))
    if absent_entries:
        noun, _, name, known_names = absent_entries[0]
        raise RefusedError(
            "\n".join(
                f"{at(field)}no stored run is of {noun} {echo(name, 64)}" for noun, field, name, _ in absent_entries
            ),
            remedy=nearest(name, known_names, "batches" if noun == "batch" else f"{noun}s"),
        )


def software_words(runs: Sequence[RunLine]) -> list[str]:
    """Name the software versions of the analyses: the program, and packages that differ between runs."""
    versions = {run.software for run in runs}
    common = set.intersection(*map(set, versions)) if versions else set()
    words_by_software = {
        pairs: ", ".join(
            f"{name} {version}" for name, version in pairs if (name, version) not in common or name == "cbsr-qa"
        )
        for pairs in versions
    }
    return [words_by_software[run.software] for run in runs]


def clock_notes(runs: Sequence[RunLine]) -> tuple[str, ...]:
    """Name runs whose times show that a station's clock was wrong; their identifiers give the order."""
    notes = []
    for station in sorted({run.station for run in runs}):
        station_runs = [run for run in runs if run.station == station]
        for earlier, later in pairwise(station_runs):
            gap = earlier.started_at - later.started_at
            if gap > _CLOCK_STEP:
                days = gap / timedelta(days=1)
                span = f"{days / 365.25:.1f} years" if days > 300 else f"{days:.0f} days"
                notes.append(
                    f"the clock of {prefix_kind('station', station)} was wrong by about {span} at one of two "
                    f"runs: {later.words} came after {earlier.words}; "
                    "runs are in the order they were made in, not in that of the clock"
                )
    return tuple(notes)


def likeness_notes(store: Repository, runs: Sequence[RunLine]) -> tuple[str, ...]:
    """Report several versions of analyses, or differences in measuring between the first and the last run."""
    versions = Counter(dict(run.software).get("cbsr-qa") or "not noted" for run in runs)
    notes = []
    if len(versions) > 1:
        counts = ", ".join(f"{version} ({plural(count, 'run')})" for version, count in sorted(versions.items()))
        notes.append(
            f"the runs were analysed with several versions of cbsr-qa: {counts}; a change may be the software's"
        )
    first_run, last_run = runs[0], runs[-1]
    if measuring_digest(store.runs.read_configuration(first_run.run)) != measuring_digest(
        store.runs.read_configuration(last_run.run)
    ):
        notes.append(
            f"recipe {last_run.recipe}, sensor type, material or head was not the same at the first of these runs, "
            f"{first_run.words}, and at the last, {last_run.words}; a change may be theirs"
        )
    return tuple(notes)


def add_ways(store: Repository, runs: Sequence[RunLine]) -> tuple[RunLine, ...]:
    """Return the runs with how their calibrations were made; the files of those with a batch as prior are read.

    StoreError if a configuration or a calibration cannot be read.
    """
    ways = store.fleet.read_ways([run.run for run in runs if not run.altered])
    return tuple(replace(run, way=_complete_way(store, *ways[run.run])) if run.run in ways else run for run in runs)


def _complete_way(store: Repository, way: CalibrationWay, calibration: str) -> CalibrationWay:
    if not way.batch_model or not calibration:
        return way
    from cbsr_qa.calibration.file.hdf5 import calibration_of  # loads what runs without a batch do not need

    file, digest = store.calibrations.load_file(calibration)
    force = calibration_of(file, issued=digest).force
    return replace(way, unlike=force is not None and force.batch is not None and not force.batch.alike)


def count_ways(runs: Sequence[RunLine]) -> tuple[WayCount, ...]:
    """Count runs by how their calibrations were made, the most frequent way first."""
    counts = Counter(run.way for run in runs if run.way is not None)
    return tuple(WayCount(way, count) for way, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def describe_several_ways(ways: Sequence[WayCount]) -> str:
    """Say that calibrations were made in several ways; empty if they were not."""
    if len(ways) < 2:
        return ""
    return "; ".join(f"{counted.way.words} ({plural(counted.runs, 'run')})" for counted in ways)


def describe_recipes(recipes: Collection[str]) -> str:
    """Return a clause on runs of several recipes, of which a study needs one."""
    return f"{len(recipes)} recipes: {list_names(sorted(recipes))}"


def measuring_digest(configuration: str, adopted: str = "") -> str:
    """SHA-256 of the parts of a stored configuration that affect numbers: neither limits nor a simulation's seed.

    Parameters
    ----------
    adopted : recipe of an adopted re-analysis, in place of the run's own; empty without one.
    """
    content = json.loads(configuration)
    recipe = json.loads(adopted) if adopted else _table(content, "recipe")
    sensor_type = {
        key: {name: value for name, value in table.items() if name not in ("serial_pattern", "unique_parts")}
        if isinstance(table, dict)
        else table
        for key, table in _table(content, "sensor_type").items()
    }
    measuring = {
        "recipe": {key: value for key, value in recipe.items() if key not in _NOT_MEASURING},
        "sensor_type": sensor_type,
        "material": _table(content, "material"),
        "indenter": _table(_table(content, "station"), "indenter"),
    }
    return hashlib.sha256(canonical_json(measuring).encode()).hexdigest()


def _table(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    table = content.get(key, {})
    return table if isinstance(table, Mapping) else {}
