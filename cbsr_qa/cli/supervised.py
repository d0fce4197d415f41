"""A command in a child process, and its parent, which runs no plugin code; see docs/decisions/0024."""

import errno
import io
import json
import os
import select
import signal
import sys
import threading
import time
from contextlib import suppress
from importlib import import_module
from typing import Any, ClassVar, Final, NamedTuple

from cbsr_qa.cli.output import claim_stdout, note, say
from cbsr_qa.domain.errors import BrokenError, BrokenRunError, CbsrError
from cbsr_qa.system.copies import end_copies_of_threads, end_copy
from cbsr_qa.system.fork_server import begin_fork_server
from cbsr_qa.system.json_text import parse_json
from cbsr_qa.system.stubborn import be_watched

#: Signals passed on to the child; a run then stops cleanly.
_HANDED_ON: Final = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP")
    if hasattr(signal, name)  # Windows knows two
)
#: Longest time for the child to echo a signal [s].
_ECHO_S: Final = 0.25

_Mask = set[int | signal.Signals]


class BrokenProcessError(BrokenError):
    """The process of a command ended unexpectedly; no run had begun (exit code 3)."""


def report_run(run: str, database: str | None) -> None:
    """Report run and database (None: the default) to the parent, if any."""
    _Child.tell(run=run, database=database)


def supervise(*, judges: bool, live: bool = False, reads: str = "") -> int | None:
    """Fork: the child carries out the command, the parent waits for its end and shows its output.

    Parameters
    ----------
    judges : whether success means that a sensor passed, which the database must confirm.
    live : whether the child keeps standard output; else its parent prints what it leaves.
    reads : module that the child imports before it has anything open; its fork server has it then.

    Returns
    -------
    None in the child, which must call :func:`end_child`; in the parent the exit code that the child has reported.

    Raises
    ------
    BrokenRunError, BrokenProcessError
        In the parent, if the child ended in any other way.
    """
    if judges:
        # The child needs it as well, and has it then: it is half a second to load.
        from cbsr_qa.store.runs import outcomes  # noqa: F401
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _HANDED_ON)  # signals wait until handlers are in place
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    report, alive, echo = os.pipe(), os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        for end in (report[0], alive[1]):  # echo stays open at both ends: its reader may be killed
            os.close(end)
        if reads:
            with suppress(ImportError):  # the command says it
                import_module(reads)
            begin_fork_server()
        _Child.begin(mask, report=report[1], alive=alive[0], echo=echo[1], live=live)
        return None
    for end in (report[1], alive[0], echo[1]):
        os.close(end)
    try:
        parent = _Parent(child, report[0], echo[0], mask)
        status = parent.wait()
    finally:
        for end in (report[0], alive[1], echo[0]):
            os.close(end)
    return _conclude(parent.read_report(), status, judges=judges)


def end_child(code: int) -> None:
    """Report the exit code to the parent and end this process; does nothing in other processes."""
    _Child.end(code)


class _Child:
    """The process that runs plugin code."""

    report: ClassVar[int | None] = None
    process: ClassVar[int]
    pipe: ClassVar[os.stat_result]
    printed: ClassVar[io.TextIOWrapper]

    @classmethod
    def tell(cls, **message: Any) -> None:
        """Report to the parent; nothing happens once it has gone, since this process is then about to be stopped.

        OSError if a plugin closed the pipe, or its number now belongs to another file.
        """
        if cls.report is None:
            return
        if not os.path.samestat(os.fstat(cls.report), cls.pipe):
            raise OSError(errno.EBADF, "the pipe to the parent was closed")
        line = f"{_mark(os.getpid())}{json.dumps(message)[1:]}".encode()
        remaining = b"\n" + line + b"\n"  # keeps anything a plugin wrote there on a separate line
        with suppress(BrokenPipeError):
            while remaining:
                remaining = remaining[os.write(cls.report, remaining) :]

    @classmethod
    def begin(cls, mask: _Mask, *, report: int, alive: int, echo: int, live: bool) -> None:
        """Redirect output to the parent, and install signal handlers."""
        encoding = getattr(sys.stdout, "encoding", None) or "utf-8"  # for escaping what cannot be shown
        cls.report, cls.pipe, cls.process = report, os.fstat(report), os.getpid()
        cls.printed = io.TextIOWrapper(io.BytesIO(), encoding, newline="")
        claim_stdout(None if live else cls.printed)
        be_watched()
        end_copies_of_threads()
        os.set_blocking(echo, False)
        signal.set_wakeup_fd(echo, warn_on_full_buffer=False)  # C code writes every signal's number there
        threading.Thread(target=_end_with_parent, args=(alive,), name="parent", daemon=True).start()
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    @classmethod
    def end(cls, code: int) -> None:
        if cls.report is None:
            return
        end_copy(cls.process)
        try:
            signal.pthread_sigmask(signal.SIG_BLOCK, _HANDED_ON)
            _name_what_runs()
            cls.printed.seek(0)
            with suppress(OSError):  # the parent notices a missing report
                cls.tell(code=code, printed=cls.printed.read())
            if sys.stderr is not None:
                with suppress(OSError):
                    sys.stderr.flush()
        finally:
            os._exit(code)  # does not wait for threads or exit hooks


def _mark(child: int) -> str:
    """Return the beginning of every message of a process."""
    return f'{{"pid": {child}, '


def _name_what_runs() -> None:
    if "cbsr_qa.plugin.discovery" not in sys.modules:  # no plugin was loaded
        return
    from cbsr_qa.plugin.discovery import name_left_threads

    for line in name_left_threads([threading.main_thread()]):
        note(f"warning: {line}")


def _end_with_parent(alive: int) -> None:
    """Stop this process once the parent has gone, by SIGTERM: a run handles it and ends in order.

    Without a handler yet, stop as by Ctrl-C, which closes open files, while SIGTERM would kill.
    """
    with suppress(OSError):
        os.read(alive, 1)
    note("cbsr-qa: the process that watches over this one has gone: this one stops")
    hears_sigterm = signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ignores_sigint = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGTERM if hears_sigterm or ignores_sigint else signal.SIGINT)


class _Parent:
    """Waits for the child, and passes signals on to it.

    The keyboard's signals reach both processes, those sent to the parent do not. A signal the child has not echoed
    within :data:`_ECHO_S` is passed on, but never twice, which would mean "at once" to a run.
    """

    def __init__(self, child: int, report: int, echo: int, mask: _Mask) -> None:
        self._child, self._report, self._echo, self._mask = child, report, echo, mask
        self._received = bytearray()
        self._reads = True

    def read_report(self) -> dict[str, Any]:
        """Return what the child reported, later messages over earlier ones; ignores what plugins wrote."""
        mark, reported = _mark(self._child).encode(), dict[str, Any]()
        for line in self._received.splitlines():
            with suppress(ValueError):
                reported |= parse_json(bytes(line)) if line.startswith(mark) else {}
        return reported

    def wait(self) -> int:
        """Return the status the child ended with."""
        wake_reader, wake_writer = os.pipe()
        for end in (wake_reader, wake_writer, self._report, self._echo):
            os.set_blocking(end, False)
        waker = signal.set_wakeup_fd(wake_writer, warn_on_full_buffer=False)
        heard_signals = [n for n in _HANDED_ON if signal.getsignal(n) is not signal.SIG_IGN]
        previous_handlers = {
            number: signal.signal(number, lambda *_: None) for number in (*heard_signals, signal.SIGCHLD)
        }
        try:
            signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
            while (status := self._poll_child()) is None:
                select.select([wake_reader, *[self._report] * self._reads], [], [])
                self._read_report()
                unheard = self._unheard({*(_read(wake_reader) or b"")} & {*heard_signals})
                for number in unheard:
                    os.kill(self._child, number)
                self._unheard(unheard)  # so that its echo does not answer the next one
            self._read_report()
            return status
        finally:
            for number, handler in previous_handlers.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(waker)
            os.close(wake_reader)
            os.close(wake_writer)

    def _poll_child(self) -> int | None:
        """Return the child's status once it has ended; stop and continue with it (Ctrl-Z)."""
        changed_child, status = os.waitpid(self._child, os.WNOHANG | os.WUNTRACED)
        if changed_child and os.WIFSTOPPED(status):
            os.kill(os.getpid(), signal.SIGSTOP)
            os.kill(self._child, signal.SIGCONT)
        return status if changed_child and not os.WIFSTOPPED(status) else None

    def _read_report(self) -> None:
        while self._reads and (chunk := _read(self._report)) is not None:
            self._received += chunk
            self._reads = bool(chunk)

    def _unheard(self, numbers: set[int]) -> set[int]:
        """Wait for the echoes of signals; return the signals without an echo."""
        unheard, until_s = set(numbers), time.monotonic() + _ECHO_S
        while unheard and (wait_s := until_s - time.monotonic()) > 0:
            if select.select([self._echo], [], [], wait_s)[0]:
                heard = _read(self._echo)
                if not heard:  # it has ended
                    break
                unheard -= set(heard)
        return unheard


def _read(end: int) -> bytes | None:
    """Return the content of a pipe; None if it is empty, no bytes if it was closed."""
    try:
        return os.read(end, 1 << 16)
    except BlockingIOError:
        return None


def _conclude(reported: dict[str, Any], status: int, *, judges: bool) -> int:
    code, run, database = reported.get("code"), reported.get("run"), reported.get("database")
    reason = _cut_off(status, code)
    if reason:
        reason = f"the process of the {'run' if judges else 'command'} {reason}"
        if judges and run is not None:
            reason += f"; {_look_up_run(run, database).words}"
    elif judges and not code:
        reason = _explain_unconfirmed(run, database)
    if reason:
        raise _broken(run, database, reason, judges=judges)
    if reported["printed"]:
        say(reported["printed"].removesuffix("\n"))
    assert isinstance(code, int)
    return code


def _broken(run: str | None, database: str | None, why: str, *, judges: bool) -> CbsrError:
    from cbsr_qa.app.command_hints import database_option

    look = "check the bench before you touch it: the head may be down and the source on"
    if not judges:
        return BrokenProcessError(why, remedy=f"if the command uses the bench, {look}. Then start it again")
    if run is None:
        return BrokenProcessError(f"{why}; no run had begun", remedy=f"{look}. Then start it again")
    stored_run = _look_up_run(run, database)
    if not stored_run.stored:  # it was named before anything of it was stored
        return BrokenProcessError(why, remedy=f"{look}. Then start it again: nothing can be continued")
    # Only the files of a result may be missing.
    next_command = f"cbsr-qa {'report' if stored_run.result else 'run --resume'} {run}{database_option(database)}"
    return BrokenRunError(run, why, remedy=f"{look}. The stored data are kept; continue with: {next_command}")


def _cut_off(status: int, code: int | None) -> str:
    """Return how the child ended if it did not return its exit code; else empty."""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return f"was killed by {next((s.name for s in signal.Signals if s == number), f'signal {number}')}"
    actual = os.WEXITSTATUS(status)
    if code is None:
        return (
            f"ended without a report, with exit code {actual}: a plugin may have ended it (os._exit) or closed files"
            " that are not its own"
        )
    return "" if code == actual else f"reported exit code {code} and ended with exit code {actual}"


def _explain_unconfirmed(run: str | None, database: str | None) -> str:
    """Return why the database does not confirm that a run has passed; empty if it does."""
    if run is None:
        return "the process of the run ended without a verdict"
    stored_run = _look_up_run(run, database)
    return "" if stored_run.passed else f"the process of the run reported success, and {stored_run.words}"


class _Held(NamedTuple):
    """Content of a database on a run, as far as it can be read.

    Parameters
    ----------
    words : content in words.
    stored, result, passed : whether the run, its result, and a pass are stored.
    """

    words: str
    stored: bool = True
    result: bool = False
    passed: bool = False


def _look_up_run(run: str, database: str | None) -> _Held:
    from cbsr_qa.config.paths import database_url
    from cbsr_qa.domain.run.states import ResultState
    from cbsr_qa.store.runs.outcomes import NoRunError, latest_result

    try:
        result, outcome = latest_result(database_url(database), run)
    except NoRunError:
        return _Held("nothing of the run was stored", stored=False)
    except CbsrError as error:
        return _Held(f"its verdict cannot be read back: {error.reason.removeprefix(f'run {run}: ')}")
    verdict_text = "no verdict" if outcome is None else f"the verdict {str(outcome)!r}"
    has_passed = outcome is not None and not outcome.exit_code
    return _Held(f"the database holds {verdict_text}", result=result is ResultState.STORED, passed=has_passed)
