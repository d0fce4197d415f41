"""Cautions about a whole comparison: runs left out, mixtures, clocks, and groups with little information.

Wrong clocks of stations are recognised by the order of runs, the present time, runs' identifiers, and other stations.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime, timedelta
from statistics import median
from typing import Final

from cbsr_qa.domain.numbers import prefix_kind
from cbsr_qa.domain.results.fleet import RunLine
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.studies.compare.groups import NO_BATCH, Design, Grouping
from cbsr_qa.studies.compare.models import Fitted
from cbsr_qa.studies.compare.terms import By, Terms
from cbsr_qa.studies.selection import count_ways, describe_several_ways, software_words

_DAY: Final = timedelta(days=1)
#: One batch is tested within this time; otherwise a clock is wrong.
_LONGEST_BATCH: Final = timedelta(days=200)
#: With no more degrees of freedom, sessions that differ are seldom shown.
_HARDLY_ANY: Final = 2

_LEFT_OUT: Final = "Left out: {runs} {why}"
_ONE_GROUP: Final = "There is only one {by}, {name}: nothing to compare it with"
_ONE_SENSOR: Final = "{name} has only one sensor, which does not show how sensors differ"
_SEVERAL_GROUPS: Final = "Runs put {sensors} into several groups, which is a mistake in one of them: {serials}"
_NESTED: Final = "Batches of one material are treated as alike: intervals do not include how they differ"
_ONE_BATCH: Final = "A difference of materials cannot be separated from one of batches: {materials}"
_RESTS_ON: Final = (
    "Differences of {noun}s rest on batches that ran at one station in both, compared with {reference}: {groups}"
)
_SESSIONS: Final = (
    "These runs cannot tell a {noun} from its session at a station: what was particular then counts as the {noun}'s; "
    "to tell them apart, run some sensors of {group} on {station} too"
)
_FEW_SESSIONS: Final = (
    "These runs hardly show whether sessions of a {noun} at a station differ ({freedom}): what looks like a "
    "difference of one {noun} from another may be one of sessions; sensors of each {noun} on more stations would tell"
)
_LACK_OF_FIT: Final = (
    "How far one {noun} is from another depends on the station, by more than their sensors explain: intervals of "
    "{count} of {metrics} are wider, since they include how sessions of a {noun} at a station differ"
)
_MIXED: Final = "Mixed {what}, which a difference of groups may come from: {shares}"
_STILL_TO_COME: Final = "The clock of {station} was wrong: {runs} began on {day}, which is still to come"
_SET_BACK: Final = (
    "The clock of {station} was set back: {runs} state {back}, but were made after a run that states {day}; runs are "
    "taken in the order they were made in"
)
_IDENTIFIERS: Final = (
    "The clock of {station} was wrong, or that of the computer that named the runs: {runs} state {first} to {last}, "
    "and were named {days:.0f} days {side}"
)
_FAR: Final = (
    "The clock of {station} may be wrong: by it, batch {batches} ran {days:.0f} days away from other stations"
)
_PERIODS: Final = "Periods are taken from these clocks: compare by batch, or leave days out by --since, --until"


def cautions(
    members: Sequence[RunLine],
    grouping: Grouping,
    design: Design,
    models: Sequence[Fitted],
    terms: Terms,
    now: datetime,
) -> Iterator[str]:
    """Return cautions about the runs that count, in order of time, and about the models of all metrics."""
    for why, count in sorted(grouping.left_out.items()):
        yield _LEFT_OUT.format(runs=plural(count, "run"), why=why)
    yield from _caution_groups(members, grouping, terms)
    yield from _name_common_batches(grouping, design)
    yield from _caution_sessions(design, models)
    for mixed_kind, names in (
        ("recipes", [run.recipe for run in members]),
        ("software versions", [] if terms.by is By.SOFTWARE else software_words(members)),
        ("simulated and real benches", ["simulated" if run.simulated else "real" for run in members]),
    ):
        counts = Counter(names).most_common()
        if len(counts) > 1:
            shares = "; ".join(f"{name} ({plural(count, 'run')})" for name, count in counts)
            yield _MIXED.format(what=mixed_kind, shares=shares)
    if several := describe_several_ways(count_ways(members)):
        yield _MIXED.format(what="ways to calibrate", shares=several)
    clocks = [*_name_future_runs(members, now), *_name_disordered_runs(members)]
    clocks += [*_name_unlike_identifiers(members), *_far_from_others(members)]
    yield from clocks
    if clocks and terms.by is By.PERIOD:
        yield _PERIODS


def _caution_groups(members: Sequence[RunLine], grouping: Grouping, terms: Terms) -> Iterator[str]:
    if len(grouping.names) == 1:
        yield _ONE_GROUP.format(by=terms.by, name=grouping.reference)
    yield from (_ONE_SENSOR.format(name=name) for name in grouping.names if len(grouping.tests[name]) == 1)
    owners = Counter(serial for name in grouping.names for serial in grouping.tests[name])
    several = sorted(serial for serial, count in owners.items() if count > 1)
    if several and terms.by in (By.BATCH, By.MATERIAL):
        yield _SEVERAL_GROUPS.format(sensors=plural(len(several), "sensor"), serials=list_names(several))
    if terms.by is By.MATERIAL:
        batches = {
            name: {run.batch or NO_BATCH for run in members if run.material == name} for name in grouping.names
        }
        single = [f"{name} is batch {next(iter(of))} only" for name, of in batches.items() if len(of) == 1]
        yield _ONE_BATCH.format(materials=", ".join(single)) if single else _NESTED


def _name_common_batches(grouping: Grouping, design: Design) -> Iterator[str]:
    """Name the batches behind differences of periods or software versions."""
    if design.levels:
        shared = {name: design.common_batches(name, grouping.reference) for name in grouping.names[1:]}
        groups = list_names([f"{name} (batch {list_names(batches)})" for name, batches in shared.items() if batches])
        if groups:
            yield _RESTS_ON.format(noun=design.noun, reference=grouping.reference, groups=groups)


def _caution_sessions(design: Design, models: Sequence[Fitted]) -> Iterator[str]:
    """Say that sessions widen intervals; or that the runs hardly show them, or not at all, and which run would."""
    made, noun = design.crossing, str(By.BATCH) if design.of_stations else design.noun
    widened = sum(model.fit is not None and model.fit.session_deviation is not None for model in models)
    if widened:
        yield _LACK_OF_FIT.format(noun=noun, count=widened, metrics=plural(len(models), "metric"))
    sessions = set(zip(made.group.tolist(), made.station.tolist(), strict=True))
    freedom = len(sessions) - int(made.independent_columns().sum())
    if design.levels or len(made.groups) < 2 or freedom > _HARDLY_ANY:
        return
    if freedom:
        if not widened:
            yield _FEW_SESSIONS.format(noun=noun, freedom=plural(freedom, "degree of freedom", "degrees of freedom"))
        return
    for group, part in enumerate(made.group_parts.tolist()):
        for station in range(len(made.stations)):
            if made.station_parts[station] == part and (group, station) not in sessions:
                yield _SESSIONS.format(noun=noun, group=made.groups[group], station=made.stations[station])
                return
    yield _SESSIONS.format(noun=noun, group=made.groups[0], station="a second station")


def _name_future_runs(runs: Sequence[RunLine], now: datetime) -> Iterator[str]:
    for station, members in _group_by_station(run for run in runs if run.started_at > now + _DAY):
        latest = max(run.started_at for run in members)
        yield _STILL_TO_COME.format(station=station, runs=_runs(members), day=f"{latest:%Y-%m-%d}")


def _name_disordered_runs(runs: Sequence[RunLine]) -> Iterator[str]:
    """Name stations whose clock was set back: a run made after another one began before it."""
    for station, members in _group_by_station(runs):
        latest, runs_set_back = members[0], []
        for run in members:
            if run.started_at < latest.started_at - _DAY:
                runs_set_back.append(run)
            else:
                latest = max(latest, run, key=lambda run: run.started_at)
        if runs_set_back:
            earliest_day, latest_day = (
                f"{run.started_at:%Y-%m-%d}" for run in (min(runs_set_back, key=lambda run: run.started_at), latest)
            )
            yield _SET_BACK.format(station=station, runs=_runs(runs_set_back), back=earliest_day, day=latest_day)


def _name_unlike_identifiers(runs: Sequence[RunLine]) -> Iterator[str]:
    """Name runs with another day than that of their identifiers, if most runs agree.

    If most do not, the fleet was stored all at once (simulated, or copied), and identifiers do not tell about clocks.
    """
    away = {run.run: (run.made_at - run.started_at) / _DAY for run in runs if run.made_at is not None}
    if not away or median(abs(days) for days in away.values()) > 1:
        return
    for station, members in _group_by_station(run for run in runs if abs(away.get(run.run, 0.0)) > 1):
        days = median(away[run.run] for run in members)
        start_days = sorted(f"{run.started_at:%Y-%m-%d}" for run in members)
        side = "later" if days > 0 else "earlier"
        yield _IDENTIFIERS.format(
            station=station, runs=_runs(members), first=start_days[0], last=start_days[-1], days=abs(days), side=side
        )


def _far_from_others(runs: Sequence[RunLine]) -> Iterator[str]:
    """Name stations that tested their batches in another year than the other stations."""
    days: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for run in runs:
        if run.batch:
            days[run.station][run.batch].append(run.started_at.timestamp() / 86400)
    for station, batches in days.items():
        gaps = []
        for batch, station_days in batches.items():
            other_days = [day for name in days if name != station for day in days[name].get(batch, ())]
            if other_days:
                gaps.append((abs(median(station_days) - median(other_days)), batch))
        far_batches = [batch for gap, batch in gaps if gap > _LONGEST_BATCH.days]
        # Of two stations each is far from the other; of more, the outlier has most gaps.
        if far_batches and len(far_batches) == len(gaps):
            yield _FAR.format(
                station=prefix_kind("station", station), batches=list_names(far_batches), days=max(gaps)[0]
            )


def _group_by_station(runs: Iterable[RunLine]) -> Iterator[tuple[str, list[RunLine]]]:
    by_station: dict[str, list[RunLine]] = {}
    for run in runs:
        by_station.setdefault(run.station, []).append(run)
    return ((prefix_kind("station", station), members) for station, members in by_station.items())


def _runs(members: Sequence[RunLine]) -> str:
    return f"{plural(len(members), 'run')} ({list_names(sorted({run.serial for run in members}))})"
