"""Check a station: its instruments, a reference ring, a golden sensor; the check is stored with the runs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

from cbsr_qa.app.run.console import NOBODY, RunConsole
from cbsr_qa.app.run.stopping import stoppable
from cbsr_qa.app.station_check.bench import (
    WHOLE_BENCH,
    BenchFindings,
    Confirm,
    RecordingEnded,
    look_at_bench,
)
from cbsr_qa.app.station_check.golden_run import describe_placing, may_press, run_golden
from cbsr_qa.app.station_check.outcome import CheckedStation, check_outcome
from cbsr_qa.app.station_check.request import CheckRequest, choose_ring, load_configuration, refuse_both
from cbsr_qa.app.station_check.ring import simulates_frames
from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.paths import calibrations_folder, database_url, reports_folder, writable_folder
from cbsr_qa.domain.errors import CbsrError, RefusedError
from cbsr_qa.domain.plan.plan import ReferenceRing, Station
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.links.recorder import Recorder
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.transcript import Transcript
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.report.render import render_sections, report_name, write_report
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.station.control.lock import station_held
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.station.setup import station_clock
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import Clock, RealClock, VirtualClock

#: Words for no ring, and for that of the station file, in the head of a transcript.
_NO_RING, _STATED_RING = "none", "stated"


def check_station(request: CheckRequest, console: RunConsole = NOBODY) -> CommandOutcome[CheckedStation]:
    """Check a station, store the check, and write its page.

    Without an operator, what must be connected first is not measured, and instruments worked by hand do not answer.

    Raises
    ------
    RefusedError
        Before anything is opened: a file, a name or an option is wrong, or the database cannot be used. Also if no
        instrument could be opened at all, because of its driver or options.
    AbortedError
        If a signal stopped it; the bench is safe then, and nothing is stored.
    """
    plugins = discover()
    configuration = load_configuration(request, plugins)
    ring = choose_ring(request, configuration.station.reference_ring)
    simulated = simulates_frames(configuration.station)
    refuse_both(request, ring, simulated)
    for folder in (reports_folder(), calibrations_folder()):
        writable_folder(folder)
    ask = console.ask if console.attended else None
    confirm: Confirm = None if ask is None else lambda words: _ask_confirmation(ask, words)
    # The operator is asked only once for each thing.
    confirm_placed: Confirm = None if simulated or confirm is None else cache(confirm)
    with open_store(database_url(request.database), tell=on_stderr) as store:
        if confirm_placed is not None and request.golden is not None and ring is None:
            # Contacts are checked while the instruments are linked: something must be connected by then.
            confirm_placed(describe_placing(request.golden))
        doing = "checking the station"
        with station_held(configuration.station.name, who=request.operator, doing=doing), stoppable():
            clock = station_clock(configuration)
            with _recording(request, ring, configuration.station, clock) as recorder:
                findings = look_at_bench(
                    configuration,
                    plugins,
                    clock,
                    today=RealClock().wall().date(),
                    ring=ring,
                    confirm=(lambda words: True) if request.ring_connected else confirm,
                    ask=ask,
                    tell=console.tell,
                    tap=recorder,
                )
        if not findings.instruments and len(findings.refused) == len(configuration.station.instruments):
            raise findings.refused[0]  # no instrument could be opened at all
        findings.lines += _check_backlog(store, configuration.station)
        if recorder is not None and recorder.failure:
            findings.lines.append(_warn_of_transcript(_describe_loss(recorder), "make room, and record it again"))
        golden = None
        if request.golden is not None and may_press(request.golden, findings, confirm_placed):
            golden = run_golden(request, request.golden, findings, store, console)
        check = _compose_check(store.new_id(), request, configuration, software_versions(plugins), findings, golden)
        store.stations.save_check(check, findings.ring)
    named = "" if golden is None else golden.words
    outcome = check_outcome(check, findings.ring, configuration.sensor_type.pattern, ring, golden_run=named)
    if recorder is not None:
        outcome = _add_transcript(outcome, recorder)
    return _write_page(outcome, reports_folder() / report_name("station", check.station, check.check))


def replay_check(request: CheckRequest, path: Path, console: RunConsole = NOBODY) -> CommandOutcome[CheckedStation]:
    """Check what a transcript says in place of a station's instruments; nothing is stored.

    Raises
    ------
    RefusedError
        If the transcript was changed, or is of other instruments. One that ends early replays up to there: a warning
        says so, and what comes later is not done.
    """
    plugins = discover()
    transcript = Transcript.read(path, whole=False)
    request = _repeat_options(request, transcript)
    configuration = load_configuration(request, plugins)
    ring = choose_ring(request, configuration.station.reference_ring)
    clock = VirtualClock()

    def break_off(why: str) -> None:
        raise RecordingEnded(why)

    replay = Replay(transcript, configuration.station, clock, break_in=break_off)
    with stoppable():
        findings = look_at_bench(
            configuration,
            plugins,
            clock,
            today=RealClock().wall().date(),
            ring=ring,
            confirm=lambda words: not transcript.without_ring,
            tell=console.tell,
            tap=replay,
        )
    if transcript.early:
        findings.lines.insert(0, _warn_of_transcript(transcript.early, "what follows is not known; record it again"))
    elif (different := replay.find_difference()) is not None:
        words = different.reason.removeprefix(f"{different.role} at {different.address}: ")
        if not any(words in line.said for line in findings.lines):  # the driver did not say so
            failed, remedy = CheckOutcome.FAILED, different.remedy
            findings.lines.append(CheckResult("replay", failed, said=words, remedy=remedy, subject=different.role))
    name = f"replay of {path.name}"
    if transcript.station != configuration.station.name:
        name += f", recorded at station {transcript.station}"
    check = _compose_check(name, request, configuration, software_versions(plugins), findings, None)
    return check_outcome(check, findings.ring, configuration.sensor_type.pattern, ring)


@contextmanager
def _recording(
    request: CheckRequest, ring: ReferenceRing | None, station: Station, clock: Clock
) -> Iterator[Recorder | None]:
    """Yield a recorder to a transcript; None if none is asked for. What ends the check early is said in it."""
    if request.record is None:
        yield None
        return
    stated = {"sensor_type": request.sensor_type, "material": request.material}
    options = {name: value for name, value in stated.items() if value is not None}
    options["ring"] = (
        _NO_RING if ring is None else _STATED_RING if request.ring_ohm is None else f"{request.ring_ohm!r}"
    )
    recorder = Recorder(request.record, station, clock, options)
    try:
        yield recorder
    except BaseException as error:
        recorder.end_early(error)
        raise
    finally:
        recorder.close()
        if recorder.ended_early and recorder.has_links:
            kept = f"{recorder.path}: kept up to the stop"
            on_stderr(f"transcript {_describe_loss(recorder) if recorder.failure else kept}")


def _warn_of_transcript(said: str, remedy: str) -> CheckResult:
    return CheckResult("transcript", CheckOutcome.WARNING, said=said, remedy=remedy, subject=WHOLE_BENCH)


def _describe_loss(recorder: Recorder) -> str:
    return f"{recorder.path} is not whole: {recorder.failure}"


def _repeat_options(request: CheckRequest, transcript: Transcript) -> CheckRequest:
    """Return a request with the options of a transcript where it states none itself (RefusedError)."""
    options = transcript.options
    request = replace(
        request,
        sensor_type=request.sensor_type or options.get("sensor_type"),
        material=request.material or options.get("material"),
    )
    ring = options.get("ring", _STATED_RING)
    if not request.ring or request.ring_ohm is not None or ring == _STATED_RING:
        return request
    if ring == _NO_RING:
        return replace(request, ring=False)
    try:
        return replace(request, ring_ohm=float(ring))
    except ValueError as error:
        raise RefusedError(f"{transcript.name}: its ring is {ring!r}", remedy="take the file as recorded") from error


def _compose_check(
    name: str,
    request: CheckRequest,
    configuration: Configuration,
    software: tuple[tuple[str, str], ...],
    findings: BenchFindings,
    golden: RunIdentity | None,
) -> StationCheck:
    return StationCheck(
        check=name,
        station=configuration.station.name,
        operator=request.operator,
        checked_at=RealClock().wall(),
        sensor_type=configuration.sensor_type.name,
        configuration_digest=configuration.digest,
        software=software,
        instruments=tuple(findings.instruments),
        results=tuple(findings.lines),
        golden_run=None if golden is None else golden.run,
    )


def _ask_confirmation(ask: Callable[[str], str], words: str) -> bool:
    """Ask the operator to connect something; only an empty answer confirms it."""
    return not ask(f"{words}. Press Enter when it is done, or type s to skip it.").strip()


def _check_backlog(store: Repository, station: Station) -> list[CheckResult]:
    """Return a line on what waits for the central database, of a station that limits that."""
    limit_h = station.sync.backlog_hours
    if limit_h is None:
        return []
    backlog = store.read_backlog()
    is_late = backlog.late(limit_h)
    return [
        CheckResult(
            "backlog",
            CheckOutcome.WARNING if is_late else CheckOutcome.OK,
            backlog.age_h,
            "" if backlog.age_h is None else "h",
            f"≤ {limit_h:g} h",
            "send it: cbsr-qa db sync" if is_late else "",
            backlog.words,
            "central database",
        )
    ]


def _write_page(outcome: CommandOutcome[CheckedStation], path: Path) -> CommandOutcome[CheckedStation]:
    """Write the page; if it cannot be written, the stored check says why and stays valid."""
    try:
        write_report(path, render_sections(outcome.page, outcome.sections))
        result, printed = replace(outcome.result, page=path), str(path)
    except CbsrError as error:
        result, printed = replace(outcome.result, page_why=error.reason), f"none: {error.reason}"
    page = replace(outcome.page, printed=(("Page", printed), *outcome.page.printed))
    return replace(outcome, result=result, page=page)


def _add_transcript(outcome: CommandOutcome[CheckedStation], recorder: Recorder) -> CommandOutcome[CheckedStation]:
    """Name the transcript, and the instruments of which it has nothing."""
    silent = [role for role, events in recorder.events_by_role.items() if not events]
    events = plural(sum(recorder.events_by_role.values()), "event")
    words, why, code = f"{recorder.path}: {events}{f', none of {list_names(silent)}' if silent else ''}", "", 0
    if recorder.failure:
        why, code = _describe_loss(recorder), 1
    elif not recorder.has_links:
        why = "no instrument of this station has a serial port or VISA resource"
    path = None if why else recorder.path
    words = words if not why else why if code else f"none: {why}"
    page = replace(outcome.page, printed=(("Transcript", words), *outcome.page.printed))
    result = replace(outcome.result, transcript=path, transcript_why=why)
    return replace(outcome, result=result, page=page, exit_code=max(outcome.exit_code, code))
