"""The instruments of a station by role, made safe together even if one of them fails."""

import _thread
import os
import re
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, Final

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.plugin.failures import blame_plugin
from cbsr_qa.plugin.instruments import (
    Addressed,
    Alive,
    ForceApplicator,
    FrameSource,
    Instrument,
    Linked,
    Multiplexer,
    Sampler,
    SourceMeter,
)
from cbsr_qa.system.clock import RealClock
from cbsr_qa.system.copies import end_copy, end_forked_copies

#: Longest wait for one instrument before the next is called as well [s, real time].
PATIENCE_S: Final = 0.25
#: Longest time for all instruments together [s, real time].
DEADLINE_S: Final = 10.0

Action = tuple[str, Callable[[], object]]
#: Function called before each step with its phase and number in the recipe (both from 0).
BeginStep = Callable[[int, int], None]


class _Call:
    """One action in its own thread, which is abandoned if it never returns."""

    def __init__(self, name: str, action: Callable[[], object]) -> None:
        self.who = name
        self.done = threading.Event()
        self.why = ""
        self._action = action

    def start(self) -> None:
        """Begin the thread; RuntimeError or MemoryError where there can be none.

        A ``threading.Thread`` would wait for the thread to say that it runs, which it never does without memory.
        """
        _thread.start_new_thread(self.run, ())

    def run(self) -> None:
        try:
            with end_forked_copies():
                self._action()
        except BaseException as error:  # noqa: BLE001 - nothing one instrument does may stop the others
            self.why = f"{type(error).__name__}: {error}"
        finally:
            self.done.set()


def stop_all(
    actions: Sequence[Action], *, patience_s: float = PATIENCE_S, deadline_s: float = DEADLINE_S
) -> tuple[str, ...]:
    """Call every action in its own thread; a slow one delays the next by at most the patience.

    Quick actions run one after the other, in order, so that a simulated bench does the same each time. Waiting is in
    real time also on a virtual clock: a thread that hangs does so in real time. Returns descriptions of the actions
    that raised or missed the deadline. ``actions``: pairs (who, what to call).
    """
    clock = RealClock()
    calls = [_Call(name, action) for name, action in actions]
    for call in calls:
        try:
            call.start()
        except (RuntimeError, MemoryError):  # no more threads: call it directly
            call.run()
        call.done.wait(patience_s)
    for call in calls:
        call.done.wait(max(0.0, deadline_s - clock.now()))
    late_messages = [f"{call.who} did not answer within {deadline_s:g} s" for call in calls if not call.done.is_set()]
    return (*(f"{call.who}: {call.why}" for call in calls if call.why), *late_messages)


FRAME_SOURCE: Final = "frame_source"
FORCE_APPLICATOR: Final = "force_applicator"
SOURCE_METER: Final = "source_meter"
MULTIPLEXER: Final = "multiplexer"
#: Channel whose samples are compared with the force limit.
FORCE_CHANNEL: Final = "force"

#: Interface required for each role; any other role is a sampler, named after its channel.
_PROTOCOLS: Final[dict[str, type]] = {
    FRAME_SOURCE: FrameSource,
    FORCE_APPLICATOR: ForceApplicator,
    SOURCE_METER: SourceMeter,
    MULTIPLEXER: Multiplexer,
}
#: Order of making safe: applicators, then current sources.
_FIRST_SAFE: Final = (FORCE_APPLICATOR, SOURCE_METER, FRAME_SOURCE)


@dataclass(frozen=True, slots=True)
class Mounted:
    """One opened instrument with its table of the station file."""

    spec: InstrumentSpec
    instrument: Instrument

    @property
    def name(self) -> str:
        return f"{self.spec.role} ({self.spec.driver})"


class Bench:
    """Opened instruments, checked against the station file and linked to each other.

    ConfigError naming role and driver, if an instrument does not provide its role (one of the bench's, or a sampled
    channel), a role is filled twice or not at all, nothing measures the force, or an instrument lacks another that it
    needs.

    Parameters
    ----------
    mounted : opened instruments in the station file's order, in which they are also closed.
    stop_within_s : longest time for all of them together to reach their safe state [s, real time].
    after : further actions once all of them are closed.
    begin_step : also told of each step: the rig behind emulated instruments.
    """

    def __init__(
        self,
        mounted: Iterable[Mounted],
        *,
        stop_within_s: float = DEADLINE_S,
        after: Sequence[Action] = (),
        begin_step: BeginStep | None = None,
    ) -> None:
        self._process = os.getpid()
        self._stop_within_s = stop_within_s
        self._after = tuple(after)
        self.mounted = tuple(mounted)
        instruments = (mounting.instrument for mounting in self.mounted)
        addressed = (instrument.begin_step for instrument in instruments if isinstance(instrument, Addressed))
        self._begin_step = (*addressed, *filter(None, [begin_step]))
        mounting_by_role: dict[str, Mounted] = {}
        for mounting in self.mounted:
            for role in mounting.spec.provides:
                if role in mounting_by_role:
                    raise ConfigError(f"both {mounting_by_role[role].name} and {mounting.name} provide role {role!r}")
                mounting_by_role[role] = _check_role(mounting, role)
        self.frame_source: FrameSource = _find_role(mounting_by_role, FRAME_SOURCE)
        self.force_applicator: ForceApplicator = _find_role(mounting_by_role, FORCE_APPLICATOR)
        self.samplers = _list_samplers(
            [mounting for role, mounting in mounting_by_role.items() if role not in _PROTOCOLS]
        )
        link_instruments(self.mounted, mounting_by_role)

    def identities(self) -> tuple[InstrumentIdentity, ...]:
        """Identify every instrument; an emulated one counts as simulated, whatever it reports.

        So does one without its own address that is linked with those, such as frames scanned with a meter.
        InstrumentError if one does not answer, or is not the one in the station file.
        """
        emulates = any(mounted.spec.emulated for mounted in self.mounted)
        identities = []
        for mounted in self.mounted:
            # Without an address of its own, an instrument is as real as those it is linked to.
            linked = isinstance(mounted.instrument, Linked) and "address" not in mounted.spec.options
            identities.append(identity_of(mounted, emulated=emulates and linked))
        return tuple(identities)

    def name_of(self, instrument: object) -> str:
        return next(
            (mounted.name for mounted in self.mounted if mounted.instrument is instrument), "an unknown instrument"
        )

    def begin_step(self, phase: int, number: int) -> None:
        """Tell simulated instruments which step begins."""
        for begin_step in self._begin_step:
            begin_step(phase, number)

    def alive(self) -> tuple[Alive, ...]:
        return tuple(mounted.instrument for mounted in self.mounted if isinstance(mounted.instrument, Alive))

    def safe_state(self) -> tuple[str, ...]:
        """Bring every instrument to its safe state even if others fail: the head first, then current sources.

        Returns descriptions of those that failed; empty if none did.
        """
        by_urgency = sorted(self.mounted, key=_rank_urgency)
        return self._tell_all([(mounted.name, mounted.instrument.safe_state) for mounted in by_urgency])

    def close(self) -> tuple[str, ...]:
        """Close every instrument even if others fail; return descriptions of the failures."""
        return self._tell_all([*((mounted.name, mounted.instrument.close) for mounted in self.mounted), *self._after])

    def _tell_all(self, actions: list[Action]) -> tuple[str, ...]:
        end_copy(self._process)  # a forked copy ends here: the instruments are not its own
        return stop_all(actions, deadline_s=self._stop_within_s)


def open_bench(
    specs: Iterable[InstrumentSpec],
    make: Callable[[InstrumentSpec], Instrument],
    *,
    after: Sequence[Action] = (),
    begin_step: BeginStep | None = None,
) -> Bench:
    """Open the instruments of a station; if one fails to open, those already open are closed again.

    ConfigError if an instrument differs from the station file; also errors of ``make``.

    Parameters
    ----------
    make : function that opens one instrument (finds its factory and calls it with its context).
    after : actions (who, what to call) once the instruments are closed, also where one could not be opened.
    begin_step : see :class:`Bench`.
    """
    opened: list[Mounted] = []
    try:
        for spec in specs:
            opened.append(Mounted(spec, make(spec)))
        return Bench(opened, after=after, begin_step=begin_step)
    except BaseException:
        # The first failure is raised; a second one while closing would hide it.
        with suppress(Exception):
            stop_all([(mounting.name, mounting.instrument.safe_state) for mounting in opened])
            stop_all([*((mounting.name, mounting.instrument.close) for mounting in opened), *after])
        raise


def _rank_urgency(mounted: Mounted) -> int:
    """Return the rank in which an instrument is made safe; one that hangs delays the next."""
    ranks = [_FIRST_SAFE.index(role) for role in mounted.spec.provides if role in _FIRST_SAFE]
    return min(ranks, default=len(_FIRST_SAFE))


def identity_of(mounted: Mounted, *, emulated: bool = False) -> InstrumentIdentity:
    """Return the identity of one instrument; see :meth:`Bench.identities`.

    ``emulated``: whether it works through emulated instruments, and therefore counts as simulated.
    """
    with blame_plugin(f"instrument {mounted.spec.role!r} ({mounted.spec.driver})"):
        identity = mounted.instrument.identity()
    _check_identity(mounted.spec, identity)
    address = mounted.spec.options.get("address")
    return replace(
        identity,
        role=mounted.spec.role,
        driver=mounted.spec.driver,
        simulated=identity.simulated or mounted.spec.emulated or emulated,
        calibration_due=mounted.spec.calibration_due,
        notes=(*(() if address is None else (("address", str(address)),)), *identity.notes),
    )


def _check_identity(spec: InstrumentSpec, identity: InstrumentIdentity) -> None:
    """Refuse an instrument other than the expected one: limits and calibration dates would not apply."""
    for label, expected, reported in (
        ("model", spec.model, identity.model),
        ("serial", spec.serial, identity.serial),
    ):
        if expected and not _is_named(expected, reported):
            raise InstrumentError(
                spec.role,
                spec.address,
                f"its {label} is {reported!r}; the station file expects {expected!r}",
                remedy=f"connect the expected instrument, or correct address or {label} in the station file",
            )


def _is_named(expected: str, found: str) -> bool:
    """Whether all words of ``expected`` follow each other in ``found``: "2634B" names a "Model 2634B"."""
    expected_words, found_words = (re.findall(r"[^\s,;]+", text.casefold()) for text in (expected, found))
    return bool(expected_words) and any(
        found_words[start : start + len(expected_words)] == expected_words for start in range(len(found_words))
    )


def link_instruments(mounted: Iterable[Mounted], filled: Mapping[str, Mounted]) -> None:
    """Give every instrument that works through others those that fill the roles; ConfigError if it lacks one."""
    peers = {role: mounting.instrument for role, mounting in filled.items()}
    for mounting in mounted:
        if isinstance(mounting.instrument, Linked):
            try:
                with blame_plugin(f"instrument {mounting.spec.role!r} ({mounting.spec.driver})"):
                    mounting.instrument.link(peers)
            except ConfigError as error:
                raise ConfigError(f"instrument {mounting.name}: {error.reason}", remedy=error.remedy) from error


def _check_role(mounted: Mounted, role: str) -> Mounted:
    channel = str(getattr(mounted.instrument, "channel", "")).replace(" ", "_")
    if role not in _PROTOCOLS and role != channel:
        close_matches = get_close_matches(role, filter(None, (*_PROTOCOLS, channel)), n=1)
        hint = f"did you mean {close_matches[0]!r}? " if close_matches else ""
        raise ConfigError(
            f"instrument {mounted.name} is configured to provide {role!r}, which is neither a role nor what it"
            f" samples: {f'it samples {channel!r}' if channel else 'it samples nothing'}",
            remedy=f"{hint}roles: {', '.join(_PROTOCOLS)}, and what an instrument samples, such as 'force'",
        )
    protocol = _PROTOCOLS.get(role, Sampler)
    if not isinstance(mounted.instrument, protocol):
        members = {name for kind in protocol.__mro__ for name in vars(kind) if not name.startswith("_")}
        missing_members = sorted(name for name in members if not hasattr(mounted.instrument, name))
        raise ConfigError(
            f"instrument {mounted.name} is configured to provide {role!r} but is not a {protocol.__name__}:"
            f" it lacks {', '.join(missing_members)}",
            remedy="correct 'provides' in the station file, or use another driver",
        )
    return mounted


def _find_role(filled: dict[str, Mounted], role: str) -> Any:
    if role not in filled:
        raise ConfigError(
            f"no instrument of the station provides {role!r}",
            remedy="name it in the 'provides' of one of its instruments",
        )
    return filled[role].instrument


def _list_samplers(mounted: list[Mounted]) -> tuple[Sampler, ...]:
    samplers = tuple(mounting.instrument for mounting in mounted if isinstance(mounting.instrument, Sampler))
    if all(sampler.channel != FORCE_CHANNEL for sampler in samplers):
        raise ConfigError(
            f"no instrument of the station samples {FORCE_CHANNEL!r}",
            remedy="pressing requires a load cell: add its role to 'provides'",
        )
    return samplers
