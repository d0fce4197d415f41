"""Clocks of stations that cannot be right: from the order of runs, now, runs' identifiers, and other stations."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from statistics import median

from cbsr_qa.domain.fleet import FleetRun
from cbsr_qa.fleet.figures import named
from cbsr_qa.report.numbers import plural

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
