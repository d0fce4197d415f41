"""Check a station: its instruments, a reference ring, a golden sensor; the check is stored with the runs."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Final

from cbsr_qa.app.run.console import NOBODY, RunConsole
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.app.run.stopping import stoppable
from cbsr_qa.app.station_check.bench import (
    WHOLE_BENCH,
    BenchFindings,
    Confirm,
    RecordingEnded,
    look_at_bench,
    simulates_frames,
)
from cbsr_qa.app.station_check.golden_history import compare_golden, golden_history
from cbsr_qa.app.station_check.outcome import CheckedStation, check_outcome
from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.paths import calibrations_folder, database_url, reports_folder, writable_folder
from cbsr_qa.config.serials import validate_operator, validate_serial
from cbsr_qa.domain.errors import CbsrError, RefusedError, StoppedError
from cbsr_qa.domain.plan.plan import ReferenceRing, Station
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.run.run import RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.links.recorder import Recorder
from cbsr_qa.plugin.links.replay import Replay
from cbsr_qa.plugin.links.transcript import Transcript
from cbsr_qa.plugin.software import software_versions
from cbsr_qa.report.render import render_sections, report_name, write_report
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.station.control.lock import station_held
from cbsr_qa.station.interrupts import on_stderr
from cbsr_qa.station.setup import configure, station_clock
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import Clock, RealClock, VirtualClock

#: Shipped recipe of a golden sensor's run.
GOLDEN_RECIPE: Final = "golden-check"
#: Limits for a ring given only on the command line: those of an empty [reference_ring] table.
_RING_LIMITS: Final[Mapping[str, float]] = {
    "tolerance": 1e-3,
    "gain": 1e-2,
    "reading": 1e-2,
    "noise": 1e-3,
    "offset_V": 1e-3,
    "lead_ohm": 100.0,
}
_RING_FRAMES: Final = 16
#: Words for no ring, and for that of the station file, in the head of a transcript.
_NO_RING, _STATED_RING = "none", "stated"
#: Resistances that a station file may state.
_OHM: Final = (1e-3, 1e9)

#: Lines that must pass before the golden sensor is pressed.
_NEEDED: Final = ("identity", "together", "safe state", "closing")


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """A check to make; see the options of ``cbsr-qa station check`` and ``station record``.

    Parameters
    ----------
    record : transcript to write of all that passes between drivers and instruments; must not exist.
    """

    station: str
    golden: str | None = None
    operator: str = ""
    ring_ohm: float | None = None
    ring: bool = True
    ring_connected: bool = False
    sensor_type: str | None = None
    material: str | None = None
    seed: int = 0
    database: str | None = None
    record: Path | None = None


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
    configuration = _load_configuration(request, plugins)
    ring = _choose_ring(request, configuration.station.reference_ring)
    simulated = simulates_frames(configuration.station)
    _refuse_both(request, ring, simulated)
    for folder in (reports_folder(), calibrations_folder()):
        writable_folder(folder)
    ask = console.ask if console.attended else None
    confirm: Confirm = None if ask is None else lambda words: _ask_confirmation(ask, words)
    # The operator is asked only once for each thing.
    confirm_placed: Confirm = None if simulated or confirm is None else cache(confirm)
    with open_store(database_url(request.database), tell=on_stderr) as store:
        if confirm_placed is not None and request.golden is not None and ring is None:
            # Contacts are checked while the instruments are linked: something must be connected by then.
            confirm_placed(_describe_placing(request.golden))
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
        if request.golden is not None and _may_press(request.golden, findings, confirm_placed):
            golden = _run_golden(request, request.golden, findings, store, console)
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
    configuration = _load_configuration(request, plugins)
    ring = _choose_ring(request, configuration.station.reference_ring)
    clock = VirtualClock()
    replay = Replay(transcript, configuration.station, clock, break_in=_end_check)
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


def _end_check(why: str) -> None:
    raise RecordingEnded(why)


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


def _refuse_both(request: CheckRequest, ring: ReferenceRing | None, simulated: bool) -> None:
    if request.golden and ring is not None and request.ring_connected and not simulated:
        raise RefusedError(
            "the reference ring and a golden sensor cannot both be connected",
            remedy="leave out --ring-connected and be asked for each, or check the golden sensor with --no-ring",
        )


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


def _load_configuration(request: CheckRequest, plugins: Plugins) -> Configuration:
    validate_operator(request.operator)
    if request.golden is not None:
        validate_serial(request.golden)
    return configure(
        request.station,
        GOLDEN_RECIPE,
        sensor_type=request.sensor_type,
        material=request.material,
        seed=request.seed,
        plugins=plugins,
        unfinished=request.golden is None,
    )


def _choose_ring(request: CheckRequest, stated: ReferenceRing | None) -> ReferenceRing | None:
    """Return the station file's ring, with the resistance of the command line if given."""
    ohm = request.ring_ohm
    if not request.ring:
        if ohm is not None:
            raise RefusedError("--ring-ohm is given beside --no-ring", remedy="leave one of them out")
        return None
    if ohm is None:
        return stated
    if not _OHM[0] <= ohm <= _OHM[1]:
        raise RefusedError(f"--ring-ohm is {ohm:g}", remedy=f"a resistor has {_OHM[0]:g} to {_OHM[1]:g} ohm")
    if stated is not None:
        return replace(stated, resistance_ohm=(ohm,))
    return ReferenceRing((ohm,), frames=_RING_FRAMES, **_RING_LIMITS)


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


def _subject(serial: str) -> str:
    return f"golden sensor {serial}"


def _describe_placing(serial: str) -> str:
    return f"Put golden sensor {serial} on the station"


def _may_press(serial: str, findings: BenchFindings, confirm: Confirm) -> bool:
    """Whether the golden sensor may be run; a line says why not."""
    reason = ""
    if any(line.outcome is CheckOutcome.FAILED and line.name in _NEEDED for line in findings.lines):
        reason = "the bench is not whole"
    elif confirm is not None and not confirm(_describe_placing(serial)):
        reason = "the operator did not put it on the station"
    if reason:
        findings.lines.append(CheckResult("run", CheckOutcome.NOT_DONE, said=reason, subject=_subject(serial)))
    return not reason


def _run_golden(
    request: CheckRequest,
    serial: str,
    findings: BenchFindings,
    store: Repository,
    console: RunConsole,
) -> RunIdentity | None:
    """Run the golden sensor and add a line for each of its values; return the run, or None if not started."""
    subject = _subject(serial)

    def line(outcome: CheckOutcome, said: str, remedy: str = "") -> None:
        findings.lines.append(CheckResult("run", outcome, said=said, remedy=remedy, subject=subject))

    run_request = RunRequest(
        station=request.station,
        recipe=GOLDEN_RECIPE,
        serial=serial,
        operator=request.operator,
        sensor_type=request.sensor_type,
        material=request.material,
        database=request.database,
        golden=True,
    )
    try:
        outcome = run_sensor(run_request, console)
    except StoppedError:
        raise
    except CbsrError as error:
        line(CheckOutcome.FAILED, error.reason, error.remedy)
        return None
    record, identity = outcome.result.record, outcome.result.record.identity
    if record.end is not EndReason.FINISHED:
        line(CheckOutcome.FAILED, f"{identity.words} was {record.end}: {record.end_detail}", "measure it again")
        return identity
    line(CheckOutcome.OK, f"{identity.words}, {record.station_s / 60:.1f} min of station time")
    history = golden_history(store, outcome.run)
    measured = outcome.result.measurements
    findings.lines += compare_golden(measured, history, station=identity.station, subject=subject)
    return identity


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
