"""The stream of events: the journal stores each one before listeners see it; a journal in memory."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Final, TypeVar

from cbsr_qa.domain.errors import AbortedError, CbsrError, SafetyError
from cbsr_qa.domain.readings.frames import join_frames, join_samples
from cbsr_qa.domain.run.attendance import AttendanceEvent, pauses_of, prompts_of
from cbsr_qa.domain.run.events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunEvent,
    SamplesTaken,
    Unloaded,
)
from cbsr_qa.domain.run.run import PhaseRecord, PressDecided, RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.failures import failure
from cbsr_qa.station.interrupts import Interrupts
from cbsr_qa.station.plan import Plan

Subscriber = Callable[[RunEvent], None]
Warn = Callable[[str], None]

_RULE: Final = "journal"


class Documents:
    """Delivers each event to the journal, then to the listeners.

    Parameters
    ----------
    subscribers : receivers of events. The first is the journal and must store a document before it returns. The
        others only watch: one that raises is reported and not called again, unless it raises AbortedError to stop
        the run.
    warn : function called with a message for each listener that fails.
    """

    def __init__(self, subscribers: Sequence[Subscriber], interrupts: Interrupts, warn: Warn) -> None:
        self._journal, *self._listeners = subscribers
        self._interrupts = interrupts
        self._warn = warn

    def emit(self, event: RunEvent) -> None:
        """Deliver one event.

        SafetyError with rule ``"journal"`` if the journal could not store it.
        """
        with self._interrupts.defer():
            self._store(event)
            self._tell(event)

    def finish(self, event: RunEnded) -> RunEnded:
        """Deliver the last event; the bench is already safe, and no error is raised.

        Returns the document as delivered: broken by the journal, if the journal could not store it.
        """
        try:
            self._store(event)
        except SafetyError as error:
            event = replace(event, end=EndReason.BROKEN, detail=_describe_unstored(event, error))
        with suppress(AbortedError):  # it has ended
            self._tell(event)
        return event

    def _store(self, event: RunEvent) -> None:
        try:
            self._journal(event)
        except AbortedError:  # raised by a signal's handler, not by the journal
            raise
        except Exception as error:
            reason, remedy = (
                (error.reason, error.remedy)
                if isinstance(error, CbsrError)
                else (f"{type(error).__name__}: {error}", "")
            )
            raise SafetyError(
                _RULE, f"the journal could not store {type(event).__name__}: {reason}", remedy=remedy
            ) from error

    def _tell(self, event: RunEvent) -> None:
        for listener in tuple(self._listeners):
            try:
                listener(event)
            except AbortedError:  # it stops the run, and names the cause
                raise
            except BaseException as error:  # noqa: BLE001 - a plugin's code may raise anything
                reason = failure(error)
                self._listeners.remove(listener)
                name = getattr(listener, "__qualname__", type(listener).__qualname__)
                self._warn(f"{name} failed and receives no further events: {reason}")


def _describe_unstored(event: RunEnded, error: SafetyError) -> str:
    """Report that the end of a run could not be stored; once, if the same error ended it."""
    if event.detail.startswith(f"rule {_RULE!r}"):
        return event.detail
    end = ": ".join(filter(None, [str(event.end), event.detail]))
    return "; ".join(filter(None, [error.reason, error.remedy, f"before that the run was {end}"]))


E = TypeVar("E", FramesTaken, LoadFinished, SamplesTaken, Unloaded)


class MemoryJournal:
    """Collects the events of a run into a record."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._events: list[RunEvent] = []

    def __call__(self, event: RunEvent) -> None:
        self._events.append(event)

    def record(self, identity: RunIdentity, ended: RunEnded) -> RunRecord:
        """Return the run as it is loaded from the database, but without its sessions."""
        end_s_by_phase = {event.phase: event.time_s for event in self._events if isinstance(event, PhaseFinished)}
        started_events = [event for event in self._events if isinstance(event, PhaseStarted)]
        phases = tuple(self._phase(event, end_s_by_phase.get(event.index, ended.time_s)) for event in started_events)
        plan = self._plan
        attendance = [event for event in self._events if isinstance(event, AttendanceEvent)]
        return RunRecord(
            identity, plan.sensor_type, plan.material, plan.indenter, phases, ended.end, ended.detail, ended.time_s,
            ended.spent, pauses=pauses_of(attendance), prompts=prompts_of(attendance),
            decisions=tuple(event for event in self._events if isinstance(event, PressDecided)),
        )  # fmt: skip

    def _select_events(self, kind: type[E], phase: int) -> list[E]:
        return [event for event in self._events if isinstance(event, kind) and event.phase == phase]

    def _phase(self, event: PhaseStarted, ended_s: float) -> PhaseRecord:
        frames = [item.frames for item in self._select_events(FramesTaken, event.index)]
        samples = [item.samples for item in self._select_events(SamplesTaken, event.index)]
        channels = sorted({block.channel for block in samples})
        records = [item.record for item in self._select_events(LoadFinished, event.index)]
        loads = sorted(records, key=lambda record: record.index)
        return PhaseRecord(
            index=event.index,
            name=event.name,
            sequence=event.sequence,
            started_s=event.time_s,
            ended_s=ended_s,
            frames=join_frames(frames) if frames else None,
            samples=tuple(join_samples([item for item in samples if item.channel == name]) for name in channels),
            loads=tuple(load for load in loads if not load.eased),
            loops=tuple(load for load in loads if load.eased),
            unloaded_from_s=max((item.time_s for item in self._select_events(Unloaded, event.index)), default=None),
            role=event.role,
        )
