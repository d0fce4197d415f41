"""Where sensors stand by their last decided run: sorted for whoever takes over, found by any name."""

import string
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from cbsr_qa.app.shift.lists import group_by_sensor
from cbsr_qa.app.shift.summary import select_settled_runs
from cbsr_qa.config.serials import read_parts, validate_serial
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.numbers import find_nearest
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.listed import ListedRun
from cbsr_qa.domain.sensor.sensor_type import SensorPart
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.words import echo

#: Most sensors that a search lists, those tested last.
MOST_FOUND: Final = 200
#: Latest runs of which a name is suggested in place of an unknown one.
_RUNS_WITH_NAMES: Final = 2000
#: Most names listed that hold a text.
_MOST_ALIKE: Final = 30
#: Latest runs that are searched for an operator.
OPERATOR_RUNS: Final = 20_000
_REMEDY: Final = "give a serial number, a batch, an operator, or a part as sheet=LOT7/B, sheet=LOT7 or LOT7"


@dataclass(frozen=True, slots=True)
class SensorState:
    """Where a sensor stands with a recipe.

    Parameters
    ----------
    last : its latest run.
    settled : the latest that passed, failed or was altered; None if none did.
    """

    last: ListedRun
    settled: ListedRun | None

    @property
    def shown(self) -> ListedRun:
        """The run that says where it stands."""
        return self.settled or self.last

    @property
    def failed(self) -> bool:
        return self.settled is not None and self.settled.verdict is Outcome.FAIL

    @property
    def passed(self) -> bool:
        return self.settled is not None and self.settled.passed


@dataclass(frozen=True, slots=True)
class Handover:
    """Sensors of a shift, each counted once: as failed, else undecided, else passed.

    Parameters
    ----------
    failed, undecided : states of those sensors, the last tested first; of a sensor that was tested with several
        recipes those that decide where it is counted.
    running : states of sensors that are tested now; one that is tested again is counted by its earlier result too.
    passed : number of sensors.
    """

    passed: int
    failed: tuple[SensorState, ...]
    undecided: tuple[SensorState, ...]
    running: tuple[SensorState, ...]

    @property
    def tested(self) -> int:
        """Number of sensors whose test is over: passed + failed + undecided."""
        return self.passed + count_sensors(self.failed) + count_sensors(self.undecided)


@dataclass(frozen=True, slots=True)
class FoundSensors:
    """Sensors that a search found.

    Parameters
    ----------
    sensors : states of each sensor, those tested last first.
    count : number of sensors found; more than are listed if there are many.
    altered : number of further runs that were altered, of the latest 500: one may belong here.
    nearest : name to search for instead, where nothing was found; may be empty.
    alike : names of the latest runs with the text in them, where nothing was found; those that begin with it first.
    of_operator : whether the text is an operator of the latest :data:`OPERATOR_RUNS` runs.
    """

    sensors: tuple[tuple[SensorState, ...], ...]
    count: int
    altered: int
    nearest: str
    alike: tuple[str, ...] = ()
    of_operator: bool = False


def count_sensors(states: Collection[SensorState]) -> int:
    """Return the number of serial numbers."""
    return len({state.last.serial for state in states})


def list_states(runs: Sequence[ListedRun]) -> tuple[SensorState, ...]:
    """Return the states of the sensors of some runs, the last tested first; an altered run has one of its own."""
    return tuple(
        SensorState(own[-1], next(iter(select_settled_runs(own)[-1:]), None)) for own in group_by_sensor(runs)[::-1]
    )


def sort_for_handover(runs: Sequence[ListedRun], in_progress: Collection[str]) -> Handover:
    """Sort the sensors of a shift.

    Parameters
    ----------
    runs : in the order they were made in.
    in_progress : runs in progress; others that did not end were cut off.
    """
    states = list_states([run for run in runs if run.altered or not run.of_check])
    running = tuple(state for state in states if state.last.run in in_progress)
    over = [state for state in states if state.settled is not None or state not in running]
    failed = tuple(state for state in over if state.failed)
    not_failed = _leave_out(over, failed)
    undecided = tuple(state for state in not_failed if not state.passed)
    return Handover(count_sensors(_leave_out(not_failed, undecided)), failed, undecided, running)


def _leave_out(states: Sequence[SensorState], others: Sequence[SensorState]) -> list[SensorState]:
    """Return the states of sensors that are not among others."""
    serials = {state.last.serial for state in others}
    return [state for state in states if state.last.serial not in serials]


def search_sensors(store: Repository, wanted: str) -> FoundSensors:
    """Find sensors by serial number, batch, operator or part, among any number of stored runs.

    Parameters
    ----------
    wanted : a name; that of a part and its revision may be left out: ``sheet=LOT7/B``, ``LOT7``.

    Raises
    ------
    ConfigError
        If it can be none of these.
    StoreError
        If the database cannot be read.
    """
    serial, part = _read_wanted(wanted)
    of_serial = [serial] if serial and store.sensors.find_runs([serial]) else []
    of_part = store.sensors.find_sensors_of_part(part)
    of_batch = {} if part.name else store.sensors.find_sensors_of_batch(wanted)
    of_operator = {} if part.name else store.sensors.find_sensors_of_operator(wanted, OPERATOR_RUNS)
    others = sorted({*of_part.items(), *of_batch.items(), *of_operator.items()}, key=lambda one: one[1], reverse=True)
    serials = list(dict.fromkeys((*of_serial, *(other for other, _ in others))))
    runs = store.lists.read_named(store.sensors.find_runs(serials[:MOST_FOUND]))
    states_by_serial: dict[str, list[SensorState]] = {}
    for state in list_states(runs):
        states_by_serial.setdefault(state.last.serial, []).append(state)
    altered = store.sensors.find_altered_lately({run.run for run in runs})
    sensors = tuple(tuple(states) for states in states_by_serial.values())
    if serials:
        return FoundSensors(sensors, len(serials), len(altered), "", of_operator=bool(of_operator))
    return FoundSensors(sensors, 0, len(altered), _nearest(store, wanted), _find_alike(store, wanted))


def _list_typos(name: str) -> list[str]:
    """Return the texts that become a name by one character too many, too few, wrong or in the place of its neighbour.

    Also the name in small and in capital letters.
    """
    halves = [(name[:place], name[place:]) for place in range(len(name) + 1)]
    characters = sorted({*string.ascii_letters, *string.digits, *"._-/", *name})
    texts = {name.lower(), name.upper()}
    texts |= {before + after[1:] for before, after in halves if after}
    texts |= {before + after[1] + after[0] + after[2:] for before, after in halves if len(after) > 1}
    texts |= {before + one + after[1:] for before, after in halves if after for one in characters}
    texts |= {before + one + after for before, after in halves for one in characters}
    return sorted(texts - {name})


def _read_wanted(wanted: str) -> tuple[str, SensorPart]:
    """Return the serial number and the part that a text may mean; a part without a name stands for any."""
    if "=" in wanted:
        return "", read_parts([wanted])[0]
    try:
        (part,) = read_parts([f"any={wanted}"])
    except ConfigError:
        raise ConfigError(f"{echo(wanted, 64)} cannot be a stored name", remedy=_REMEDY) from None
    serial = ""
    with suppress(ConfigError):  # the identifier of a part may hold more
        serial = validate_serial(wanted)
    return serial, replace(part, name="")


def _find_alike(store: Repository, wanted: str) -> tuple[str, ...]:
    """Return the names of the latest runs that hold a text, those that begin with it first."""
    serials, parts, others = store.sensors.read_latest_names(_RUNS_WITH_NAMES)
    small = wanted.lower()
    names = [name for name in sorted({*serials, *map(str, parts), *others}) if small in name.lower()]
    return tuple(sorted(names, key=lambda name: not name.lower().startswith(small))[:_MOST_ALIKE])


def _nearest(store: Repository, wanted: str) -> str:
    """Return the nearest name of the latest runs, and of those of any run that differ by one character."""
    serials, parts, others = store.sensors.read_latest_names(_RUNS_WITH_NAMES)
    alike, alike_parts = store.sensors.find_names(_list_typos(wanted.partition("=")[2] or wanted))
    serials, parts = serials | alike, parts | alike_parts
    names = serials | others | {part.identifier for part in parts}
    if "=" in wanted:
        names = {*map(str, parts), *(f"{part.name}={part.identifier}" for part in parts)}
    digits = _extract_digits(wanted)
    close_digits = {digits, *_list_typos(digits)}  # a name that only looks alike is another sensor's: S-605 for S-801
    return find_nearest(wanted, {name for name in names if _extract_digits(name) in close_digits})


def _extract_digits(name: str) -> str:
    return "".join(filter(str.isdigit, name)).lstrip("0")
