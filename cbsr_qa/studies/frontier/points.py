"""Settings tried on several simulated sensors, as points of the frontier."""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.recommend import undominated_within_errors
from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import Tried
from cbsr_qa.studies.frontier.trial import UNITS

#: Accuracies used to compare settings.
DECIDES: Final = ("force_error",)


def station_points(trials: Sequence[Tried], seconds: Callable[[Setting], float]) -> list[tuple[Setting, Point]]:
    """Combine the trials of each setting, with its station time [s].

    Values are root mean squares over the sensors; their standard error is that of the mean square, to first order.
    """
    groups: dict[tuple[str, Setting], list[Tried]] = {}
    for tried in trials:
        groups.setdefault((tried.series, tried.setting), []).append(tried)
    return [
        (setting, _point(series, setting, group, seconds(setting))) for (series, setting), group in groups.items()
    ]


def worth_the_station(points: Sequence[Point]) -> tuple[bool, ...]:
    """Return for each point whether no other of any series is as good in less station time.

    Settings refused on some sensors are never worth it.
    """
    members = [at for at, point in enumerate(points) if all(name in point.accuracy for name in DECIDES)]
    kept = undominated_within_errors([points[at] for at in members], lambda point: point.station_s, DECIDES)
    flags = [False] * len(points)
    for at, on in zip(members, kept, strict=True):
        flags[at] = on
    return tuple(flags)


def _point(series: str, setting: Setting, group: Sequence[Tried], station_s: float) -> Point:
    refused = [tried for tried in group if tried.why]
    note = f"refused on {len(refused)} of {len(group)} sensors: {refused[0].why}" if refused else ""
    names = [name for name in UNITS if not refused and any(name in tried.errors for tried in group)]
    missing = {name: sum(name not in tried.errors for tried in group) for name in names}
    left_out = [
        f"{name.replace('_', ' ')} not determined on {missing[name]} of {len(group)}"
        for name in names
        if missing[name]
    ]
    return Point(
        TimeBasis.STATION,
        series,
        setting.knobs,
        {
            name: _accuracy([tried.errors[name] for tried in group], UNITS[name])
            for name in names
            if not missing[name]
        },
        None,
        station_s,
        len(group),
        "; ".join(filter(None, [note, *left_out])),
    )


def _accuracy(errors: Sequence[float], unit: str) -> Accuracy:
    squares = np.square(errors)
    value = math.sqrt(float(squares.mean()))
    if len(squares) < 2 or value == 0:
        return Accuracy(value, None, unit)
    return Accuracy(value, float(squares.std(ddof=1)) / math.sqrt(len(squares)) / (2 * value), unit)
