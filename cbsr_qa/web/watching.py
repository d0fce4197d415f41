"""Watches stations and their store in one thread: short reads when something was written, images at its own rate."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from time import monotonic
from typing import Final

from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.plan.limits import Outcome, select_failure_codes
from cbsr_qa.domain.results.measurement import describe_judgement, rank_judged
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.station.control.lock import station_holder
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.runs.live import ChangeNotice, RunLook
from cbsr_qa.system.clock import write_local_time
from cbsr_qa.web.channel import ChannelClient
from cbsr_qa.web.confirmations import name_confirmer, needs_confirmation
from cbsr_qa.web.gate import read_disposition
from cbsr_qa.web.guard import LOG
from cbsr_qa.web.live_run import DrawnPlaces, LiveRun
from cbsr_qa.web.outcomes import SHOWN_OUTCOMES
from cbsr_qa.web.processes import Started, last_start
from cbsr_qa.web.state import FailedLimit, Mode, Snapshot, mode_of
from cbsr_qa.web.stations import ServedStation
from cbsr_qa.web.texts import refusal_words, text

#: Interval between looks whether anything was written [s].
_LOOK_S: Final = 0.02
#: Shortest interval between images of one station [s].
_IMAGE_S: Final = 0.06
#: Interval between snapshots of a station of which nothing is heard [s].
_QUIET_S: Final = 1.0
#: Interval between looks whether a run in progress has ended, if its channel does not say so [s].
_END_S: Final = 0.5
#: Interval between looks at what changes by the hour: station check and backlog [s].
_HEALTH_S: Final = 15.0
#: Interval between attempts to open the store [s].
_RETRY_S: Final = 1.0
#: Time within which a run in progress answers a page that has just begun [s].
_ANSWERS_S: Final = 0.8
#: Time without frames after which a run that takes them is in trouble [s].
SILENT_S: Final = 60.0


class StationWatch:
    """One station as the watching thread knows it.

    Parameters
    ----------
    channel : channel of its runs. It belongs to the event loop; only its ``control`` is read here.

    Attributes
    ----------
    failure : error of the last look at the store; None if it succeeded.
    """

    def __init__(self, served: ServedStation, channel: ChannelClient) -> None:
        self.served, self.channel = served, channel
        self.started: Started | None = last_start(served.name)
        self.live: LiveRun | None = None
        self.look: RunLook | None = None
        self.snapshot: Snapshot | None = None
        self.failure: Exception | None = None
        self._due, self._next_s, self._look_s, self._links = True, 0.0, 0.0, -1
        self._health, self._healthy, self._health_s = "", True, 0.0
        self._reported = ""
        self._begun_s = monotonic()
        self._failed: tuple[FailedLimit, ...] = ()
        self._failed_before: RunLook | None = None
        self._standing_failure: RunLook | None = None
        self._todo = ""
        self._drawn: DrawnPlaces | None = None

    @property
    def busy(self) -> bool:
        """Whether a run is in progress, or was started and has not ended."""
        if self._alive:
            return True
        return self.channel.control is not None or station_holder(self.served.name) is not None

    @property
    def _alive(self) -> bool:
        """Whether a process that this page started has not ended."""
        started = self.started
        return started is not None and started.process is not None and started.ended is None

    @property
    def _begun(self) -> bool:
        """Whether the run that was started last is stored, at least with its beginning."""
        return self.started is not None and self.look is not None and self.look.worked_at > self.started.at

    @property
    def _was_cancelled(self) -> bool:
        """Whether somebody cancelled the start of the run that was started last."""
        started = self.started
        return started is not None and not self._begun and bool(started.cancelled_by) and started.ended is not None

    def wake(self) -> None:
        """Have a look soon."""
        self._due = True

    def look_soon(self, store: Repository) -> None:
        """Have a look soon if the run in progress has written something."""
        if self._due or self.live is None:
            self._due = self._due or self.busy
            return
        try:
            links = store.live.count_links(self.live.run)
        except CbsrError:  # the look itself says what is wrong
            self._due = True
            return
        self._due, self._links = links != self._links, links

    def refresh(self, store: Repository, plugins: Plugins) -> bool:
        """Look at station and store if it is time; return whether there is a new snapshot, with any trouble in it."""
        now_s = monotonic()
        if now_s < self._next_s or not (self._due or now_s >= self._next_s + _QUIET_S - _IMAGE_S):
            return False
        self._due, self._next_s = False, now_s + _IMAGE_S
        read_trouble = self._read(store, plugins, now_s)
        control, started = self.channel.control, self.started
        holder = station_holder(self.served.name)
        if self.snapshot is None and holder is not None and control is None and now_s < self._begun_s + _ANSWERS_S:
            return False  # a run in progress is not shown as something else while its channel is being opened
        unsafe = self.look is not None and needs_confirmation(self.look)
        starting, begun = self._alive, self._begun
        mode = mode_of(control, self.look, held=holder is not None, starting=starting, begun=begun, unsafe=unsafe)
        trouble = read_trouble or self._follow(store, plugins, mode)
        if not trouble:
            self._reported = ""
        live = None if self.live is None else self.live.view("" if control is None else control.place)
        silent_s = None if live is None else live.silent_s
        if not trouble and mode is Mode.RUNNING and silent_s is not None and silent_s >= SILENT_S:
            trouble = text("trouble.silent", seconds=round(silent_s))
        self.snapshot = Snapshot(
            station=self.served.name,
            mode=mode,
            control=control,
            look=self.look,
            failed=self._failed,
            failed_before=self._failed_before,
            live=live,
            starting=started.what if started is not None else "",
            refused=self._describe_refusal(),
            cancelled=self._was_cancelled,
            trouble=trouble,
            health=self._health,
            healthy=self._healthy,
            drawn=self._drawn,
            confirmed_by=name_confirmer(self.look) if self.look is not None and mode is Mode.DONE else "",
            standing_failure=self._standing_failure,
            todo=self._todo,
        )
        return True

    def _read(self, store: Repository, plugins: Plugins, now_s: float) -> str:
        """Read the latest run and the latest station check; return the problem, empty without one."""
        control, look = self.channel.control, self.look
        has_read_its_run = control is not None and look is not None and control.run == look.run
        try:
            if not has_read_its_run or now_s >= self._look_s:
                self._look_s = now_s + _END_S
                self._take_look(store, plugins, store.live.find_latest(self.served.name))
            self._look_after(store, now_s)
        except Exception as error:  # noqa: BLE001 - a run that cannot be read must not stop the watching of others
            self.failure = error
            return self._words(error)
        self.failure = None
        return ""

    def _take_look(self, store: Repository, plugins: Plugins, look: RunLook | None) -> None:
        """Keep the latest run, the limits that decided it with their places, and the failure before it."""
        if look == self.look:
            return
        self.look, self._failed, self._failed_before, self._drawn = look, (), None, None
        self._standing_failure, self._todo = None, ""
        if look is not None and not look.altered:
            self._failed = tuple(_list_failed(store, look))
            if any(limit.measurement is not None and limit.measurement.location for limit in self._failed):
                with suppress(CbsrError):  # such as a plugin that is no longer installed: the words say it all
                    self._drawn = LiveRun(store, plugins, look.run).draw_places()
        if look is not None and look.verdict is Outcome.FAIL:
            before = store.live.find_latest_of_sensor(look.serial, look.recipe, before=look.run)
            if before is not None and before.verdict is Outcome.FAIL:
                self._failed_before = before
        elif look is not None and look.verdict in (Outcome.PASS, Outcome.MARGINAL):
            self._standing_failure = store.live.find_standing_failure(look.serial, look.recipe)
            self._todo = "" if self._standing_failure is None else read_disposition(store, self._standing_failure)

    def _follow(self, store: Repository, plugins: Plugins, mode: Mode) -> str:
        """Read the data that the run in progress has stored; return the problem, empty without one."""
        if self.look is None or not mode.live:
            self.live = None
            return ""
        try:
            if self.live is None or self.live.run != self.look.run:
                self.live = LiveRun(store, plugins, self.look.run)
            self.live.update()
        except Exception as error:  # noqa: BLE001 - must not stop the watching of others; the run itself continues
            return self._words(error)
        return ""

    def _words(self, error: Exception) -> str:
        """Return a failure in words; a new one is logged."""
        is_own_error = isinstance(error, CbsrError)
        words = error.reason if isinstance(error, CbsrError) else text("trouble.unforeseen", error=repr(error)[:200])
        if words != self._reported:
            LOG.warning("%s: %s", self.served.name, words, exc_info=None if is_own_error else error)
        self._reported = words
        return words

    def _describe_refusal(self) -> str:
        """Return why the run that was started last never began."""
        started = self.started
        if started is None or self._begun:
            return ""
        if self._was_cancelled:
            return text("station.cancelled", by=started.cancelled_by)
        words = started.describe_refusal()
        if not words or started.process is not None:
            return words
        return f"{text('station.refused_at', when=write_local_time(started.at))}\n{words}"

    def _look_after(self, store: Repository, now_s: float) -> None:
        if now_s < self._health_s:
            return
        check = store.stations.read_latest_check(self.served.name)
        self._health_s = now_s + _HEALTH_S
        if check is None:
            self._health, self._healthy = text("health.unchecked"), True
        else:
            self._healthy = check.outcome is not CheckOutcome.FAILED
            key = "health.passed" if self._healthy else "health.failed"
            self._health = text(key, when=write_local_time(check.checked_at))
        limit_h = self.served.station.sync.backlog_hours
        if limit_h is not None and (backlog := store.read_backlog()).late(limit_h):
            self._healthy = False
            self._health += f"; {text('health.backlog', backlog=backlog.words, hours=f'{limit_h:g}')}"


def _list_failed(store: Repository, look: RunLook) -> Iterator[FailedLimit]:
    """Yield the limits that decided a run, the worst first; of a run that was cut off, the code for that."""
    if look.outcome is None:
        for code in select_failure_codes(look.coded, None, str(look.end), ()):
            yield FailedLimit("", code)
    if look.outcome in SHOWN_OUTCOMES:
        before = store.lists.read_failed_before(look.run) if look.outcome is Outcome.FAIL else ()
        measurements = store.lists.read_limited_measurements([look.run]).get(look.run, [])
        for measurement in rank_judged(measurements, look.outcome):
            keys = [measurement.limit_key]
            codes = select_failure_codes(look.coded, look.outcome, str(look.end), keys, before)
            yield FailedLimit(describe_judgement(measurement), codes[0] if codes else None, measurement)


class Watcher(threading.Thread):
    """The watching thread.

    Parameters
    ----------
    database : URL of the database.
    publish : function called in this thread with the names of stations that have a new snapshot.
    """

    def __init__(self, stations: Sequence[StationWatch], database: str, publish: Callable[[list[str]], None]) -> None:
        super().__init__(name="watcher", daemon=True)
        self._stations, self._database, self._publish = stations, database, publish
        self._woken, self._stopped = threading.Event(), False
        self.trouble = ""

    def wake(self) -> None:
        """Look at once."""
        self._woken.set()

    def stop(self) -> None:
        self._stopped = True
        self._woken.set()
        self.join(timeout=5)

    def run(self) -> None:
        while not self._stopped:
            try:
                with open_store(self._database, durable=False) as store:
                    self._watch(store, discover())
                return
            except CbsrError as error:
                self._say(refusal_words(error))
            except Exception as error:  # noqa: BLE001 - otherwise pages would freeze without a message
                self._say(text("trouble.unforeseen", error=repr(error)[:200]), error)
            self._woken.wait(_RETRY_S)
            self._woken.clear()

    def _watch(self, store: Repository, plugins: Plugins) -> None:
        notice: ChangeNotice = store.live.make_notice()
        with closing(notice):
            while not self._stopped:
                self._woken.wait(_LOOK_S)
                self._woken.clear()
                if notice.has_changed():
                    for station in self._stations:
                        station.look_soon(store)
                fresh = [watch.served.name for watch in self._stations if watch.refresh(store, plugins)]
                if fresh:
                    self._publish(fresh)
                failures = [watch.failure for watch in self._stations if watch.failure is not None]
                if len(failures) < len(self._stations):
                    self._say("")
                elif fresh:  # every station failed: the store is the cause
                    raise failures[0]

    def _say(self, trouble: str, error: Exception | None = None) -> None:
        if trouble == self.trouble:
            return
        self.trouble = trouble
        if trouble:
            LOG.error("%s", trouble, exc_info=error)
        self._publish([station.served.name for station in self._stations])
