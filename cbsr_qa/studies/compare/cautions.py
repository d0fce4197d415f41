"""What is to be kept in mind of a whole comparison: runs left out, mixtures, clocks, and groups that say little.

Clocks of stations that cannot be right: from the order of runs, now, runs' identifiers, and other stations.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from statistics import median

from cbsr_qa.domain.results import FleetRun
from cbsr_qa.report import plural
from cbsr_qa.studies.compare.design import NO_BATCH, Design
from cbsr_qa.studies.compare.figures import named
from cbsr_qa.studies.compare.groups import Grouping, software_words
from cbsr_qa.studies.compare.terms import By, Terms

_DAY = timedelta(days=1)
_TOLERATED = _DAY
#: One batch is tested within this time, or somebody's clock is wrong.
_LONGEST_BATCH = timedelta(days=200)


def clock_warnings(runs: Sequence[FleetRun], now: datetime) -> list[str]:
    """Name stations whose runs state times that cannot be, or hardly.

    Parameters
    ----------
    runs : in the order they were made in.
    now : by the computer's clock.
    """
    return [*_from_the_future(runs, now), *_out_of_order(runs), *_unlike_identifiers(runs), *_far_from_others(runs)]


def _from_the_future(runs: Sequence[FleetRun], now: datetime) -> Iterator[str]:
    late = _by_station(run for run in runs if run.started_at > now + _TOLERATED)
    for station, members in late.items():
        yield (
            f"the clock of station {station} was wrong: {_runs(members)} began on "
            f"{max(run.started_at for run in members):%Y-%m-%d}, which is still to come"
        )


def _out_of_order(runs: Sequence[FleetRun]) -> Iterator[str]:
    """A clock that was set back: a run was made after another one and began before it."""
    for station, members in _by_station(runs).items():
        latest, back = members[0], []
        for run in members:
            if run.started_at < latest.started_at - _TOLERATED:
                back.append(run)
            else:
                latest = max(latest, run, key=lambda one: one.started_at)
        if back:
            yield (
                f"the clock of station {station} was set back: {_runs(back)} were made after one that states "
                f"{latest.started_at:%Y-%m-%d} and state {min(run.started_at for run in back):%Y-%m-%d}; which is "
                "right nobody noted. Runs are taken in the order they were made in"
            )


def _unlike_identifiers(runs: Sequence[FleetRun]) -> Iterator[str]:
    """Runs that state another day than their identifiers were made on, though most runs do not.

    Where most do, the fleet was stored all at once (simulated, or copied), and identifiers say nothing of clocks.
    """
    away = {run.run: (run.made_at - run.started_at) / _DAY for run in runs if run.made_at is not None}
    most = _TOLERATED / _DAY
    if not away or median(abs(days) for days in away.values()) > most:
        return
    for station, members in _by_station(run for run in runs if abs(away.get(run.run, 0.0)) > most).items():
        days = median(away[run.run] for run in members)
        began = sorted(f"{run.started_at:%Y-%m-%d}" for run in members)
        yield (
            f"station {station} states for {_runs(members)} that they began on {began[0]} to {began[-1]}, and their "
            f"identifiers were made {abs(days):.0f} days {'later' if days > 0 else 'earlier'}: its clock was wrong, "
            "or that of whoever made the identifiers"
        )


def _far_from_others(runs: Sequence[FleetRun]) -> Iterator[str]:
    """Batches that one station says it tested in another year than the other stations did."""
    days: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        if run.batch:
            days[run.station][run.batch].append(run.started_at.timestamp() / 86400)
    for station, batches in days.items():
        gaps = []
        for batch, here in batches.items():
            others = [day for name in days if name != station for day in days[name].get(batch, ())]
            if others:
                gaps.append((abs(median(here) - median(others)), batch))
        far = [batch for gap, batch in gaps if gap > _LONGEST_BATCH.days]
        # Of two stations each is far from the other; of three and more the odd one out has most gaps.
        if far and len(far) == len(gaps):
            yield (
                f"station {station} states that it tested {named(far)} {max(gaps)[0]:.0f} days away from all other "
                "stations: its clock may be wrong, or theirs"
            )


def _by_station(runs: "Iterator[FleetRun] | Sequence[FleetRun]") -> dict[str, list[FleetRun]]:
    found: dict[str, list[FleetRun]] = {}
    for run in runs:
        found.setdefault(run.station, []).append(run)
    return found


def _runs(members: Sequence[FleetRun]) -> str:
    return f"{plural(len(members), 'run')} ({named(sorted({run.serial for run in members}))})"


def cautions(
    members: Sequence[FleetRun], grouping: Grouping, design: Design, terms: Terms, now: datetime
) -> Sequence[str]:
    """Return what is to be kept in mind, in sentences.

    Parameters
    ----------
    members : the runs that count.
    now : by the computer's clock.
    """
    said = [
        plural(count, f"run {one} and is left out", f"runs {many} and are left out")
        for (one, many), count in sorted(grouping.left_out.items())
    ]
    said += _groups_warnings(members, grouping, terms)
    said += _shared_batches(grouping, design)
    for noun, names in (
        ("recipes", [run.recipe for run in members]),
        ("software versions", [] if terms.by is By.SOFTWARE else software_words(members)),
        ("simulated and real benches", ["simulated" if run.simulated else "real" for run in members]),
    ):
        counts = Counter(names)
        if len(counts) > 1:
            shares = "; ".join(f"{name}: {plural(count, 'run')}" for name, count in counts.most_common())
            said.append(f"mixed {noun} ({shares}): a difference of groups may be one of these")
    clocks = clock_warnings(members, now)
    said += clocks
    if clocks and terms.by is By.PERIOD:
        said.append(
            "periods are taken from those clocks: compare by batch, or leave those days out by --since, --until"
        )
    return [_begun(words, grouping.names) for words in said]


def _begun(words: str, names: Sequence[str]) -> str:
    """Begin with a capital what stands alone, unless it begins with a group's name, which is as it is."""
    return words if words.startswith(tuple(names)) else words[:1].upper() + words[1:]


def _groups_warnings(members: Sequence[FleetRun], grouping: Grouping, terms: Terms) -> Sequence[str]:
    said = []
    if len(grouping.names) == 1:
        said.append(f"there is one {terms.by} only, {grouping.reference}: it is described, and compared with nothing")
    said += [
        f"{name} has one sensor only, which says nothing of how sensors differ"
        for name in grouping.names
        if len(grouping.tests[name]) == 1
    ]
    owners = Counter(serial for name in grouping.names for serial in grouping.tests[name])
    several = sorted(serial for serial, count in owners.items() if count > 1)
    if several and terms.by in (By.BATCH, By.MATERIAL):
        said.append(
            f"runs put {plural(len(several), 'sensor')} into several groups, which is a mistake in one of them: "
            f"{named(several)}"
        )
    if terms.by is By.MATERIAL:
        said += _nested(members, grouping)
    return said


def _shared_batches(grouping: Grouping, design: Design) -> Sequence[str]:
    """Say on which batches differences of periods or software versions rest."""
    if not design.levels:
        return []
    shared = {name: design.shared(name, grouping.reference) for name in grouping.names[1:]}
    told = named([f"{name} (batch {named(batches)})" for name, batches in shared.items() if batches])
    if not told:
        return []
    return [
        "every batch at every station is a level of its own in the model, so that no batch is taken for a "
        f"{design.noun}: differences from {grouping.reference} rest on batches that ran at one station in both, and "
        f"those are with {told}"
    ]


def _nested(members: Sequence[FleetRun], grouping: Grouping) -> Sequence[str]:
    batches: dict[str, set[str]] = {name: set() for name in grouping.names}
    for run in members:
        if run.material in batches:
            batches[run.material].add(run.batch or NO_BATCH)
    single = [name for name in grouping.names if len(batches[name]) == 1]
    if not single:
        return ["batches of one material are taken for alike: how they differ is not in the intervals"]
    listed = ", ".join(f"{name} is batch {next(iter(batches[name]))} only" for name in single)
    return [f"{listed}: a difference of materials cannot be told from one of batches"]
