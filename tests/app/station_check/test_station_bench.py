"""A bench looked at instrument by instrument: what fails is a line, nothing moves, nothing is left open."""

from dataclasses import replace
from datetime import date

import numpy as np
import pytest
from calibration_samples import INDENTER, LOAD_CELL

from cbsr_qa.app.station_check.bench import look_at_bench
from cbsr_qa.app.station_check.ring import with_ring
from cbsr_qa.domain.errors import AbortedError, ConfigError, InstrumentError, RefusedError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy, GateSettings
from cbsr_qa.domain.plan.plan import InstrumentSpec, ReferenceRing
from cbsr_qa.domain.readings.frames import SampleBlock
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.links.recorder import Listener
from cbsr_qa.station.setup import configure
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, ScriptedApplicator, ScriptedFrames, ScriptedLoadCell, raising

OK, WARNING, FAILED, NOT_DONE = CheckOutcome
RING = ReferenceRing((1e4,), 0.001, 5, 0.01, 0.01, 1e-3, 1e-3, 100.0)
TODAY = date(2026, 11, 22)
PROVIDED = {"force_applicator": "force_applicator", "frame_source": "frame_source", "load_cell": "force"}
ROLES = tuple(PROVIDED)


@pytest.fixture(scope="module")
def simulated():
    return configure("simulated", "golden-check", sensor_type=None, material=None, seed=3)


class Bench:
    """A composed bench of three scripted instruments, on a clock of its own."""

    def __init__(self, simulated, **station):
        self.script = Script(VirtualClock())
        applicator = ScriptedApplicator(self.script)
        shape = simulated.sensor_type.pattern.shape
        self.instruments = {
            "force_applicator": applicator,
            "frame_source": ScriptedFrames(self.script, shape, 2.5),
            "load_cell": ScriptedLoadCell(self.script, applicator),
        }
        specs = tuple(InstrumentSpec(role, f"driver-{role}", (PROVIDED[role],), {}, None) for role in ROLES)
        self.configuration = replace(simulated, station=replace(simulated.station, instruments=specs, **station))
        self.factories = {role: lambda context: self.instruments[context.role] for role in ROLES}

    def factory(self, kind, name):
        return self.factories[name.removeprefix("driver-")]

    def due(self, **dates):
        station = self.configuration.station
        specs = tuple(replace(spec, calibration_due=dates.get(spec.role)) for spec in station.instruments)
        self.configuration = replace(self.configuration, station=replace(station, instruments=specs))

    def look(self, ring=None, confirm=None):
        found = look_at_bench(
            self.configuration, self, self.script.clock, today=TODAY, ring=ring, confirm=confirm, tell=lambda _: None
        )
        self.lines = {(line.subject, line.name): line for line in found.lines}
        return found


@pytest.fixture
def bench(simulated):
    return Bench(simulated)


def test_every_instrument_is_asked_and_all_are_made_safe_before_they_are_closed(bench):
    found = bench.look()
    assert {one.role for one in found.instruments} == set(ROLES)
    for role in ROLES:
        assert bench.lines[role, "identity"].outcome is OK
        assert bench.lines[role, "self-test"].outcome is NOT_DONE
    names = bench.script.names()
    assert names.count("force_applicator.identity") == 1
    assert max(names.index(f"{role}.safe_state") for role in ROLES) < min(names.index(f"{r}.close") for r in ROLES)
    assert not {name.partition(".")[2] for name in names} & {"home", "move_to", "press", "find_surface", "acquire"}
    samples = bench.lines["load_cell", "samples of force"]
    assert (samples.outcome, samples.value) == (OK, 10.0)
    safe = bench.lines["whole bench", "safe state"]
    assert (safe.outcome, safe.said) == (OK, "reported: head up (force_applicator)")
    assert bench.lines["reference ring", "readings"].remedy.startswith("give --ring-ohm, or [reference_ring]")


SILENT = InstrumentError("load_cell", "COM3", "does not answer", remedy="plug it in")
FOREIGN = ZeroDivisionError("no denominator")


@pytest.mark.parametrize("method", ["open", "identity"])
@pytest.mark.parametrize(
    ("error", "said", "remedy"),
    [
        (SILENT, "load_cell at COM3", "plug it in"),
        (
            FOREIGN,
            "instrument 'load_cell' (driver-load_cell) failed: ZeroDivisionError: no denominator",
            "report it to the plugin's author, or do without that plugin",
        ),
    ],
)
def test_one_that_does_not_answer_is_a_line_and_the_others_are_looked_at(bench, method, error, said, remedy):
    if method == "open":
        bench.factories["load_cell"] = lambda context: raising(error)()
    else:
        bench.script.on("load_cell.identity", raising(error))
    found = bench.look(RING, lambda words: True)
    line = bench.lines["load_cell", "identity"]
    assert (line.outcome, line.remedy) == (FAILED, remedy)
    assert line.said.startswith(said)
    assert {one.role for one in found.instruments} == {"force_applicator", "frame_source"}
    assert bench.lines["reference ring", "readings"].said == "the instruments do not work together"
    opened = [role for role in ROLES if method != "open" or role != "load_cell"]
    for call in ("safe_state", "close"):
        assert [bench.script.count(f"{role}.{call}") for role in opened] == [1] * len(opened)
    assert "frame_source.acquire" not in bench.script.names()


@pytest.mark.parametrize("method", ["open", "identity"])
def test_of_a_head_or_source_that_does_not_answer_it_is_not_known_whether_it_is_safe(bench, method):
    for role in ("force_applicator", "frame_source"):
        if method == "open":
            bench.factories[role] = lambda context: raising(SILENT)()
        else:
            bench.script.on(f"{role}.identity", raising(SILENT))
    bench.look()
    line = bench.lines["whole bench", "safe state"]
    assert (line.outcome, line.said) == (WARNING, "not known for frame_source, force_applicator: no answer")
    assert line.remedy.startswith("look at the bench")


def test_a_load_cell_alone_is_not_said_to_switch_a_source_off_or_to_lift_a_head(bench):
    cell = [spec for spec in bench.configuration.station.instruments if spec.role == "load_cell"]
    bench.configuration = replace(
        bench.configuration, station=replace(bench.configuration.station, instruments=tuple(cell))
    )
    bench.look()
    line = bench.lines["whole bench", "safe state"]
    assert (line.outcome, line.said) == (OK, "every instrument says that it is safe")


def test_a_meter_and_a_head_are_named_with_what_they_say(bench):
    station = bench.configuration.station
    specs = [replace(spec, provides=(*spec.provides, "source_meter")) for spec in station.instruments[1:2]]
    station = replace(station, instruments=(*station.instruments[:1], *specs, *station.instruments[2:]))
    bench.configuration = replace(bench.configuration, station=station)
    bench.look()
    said = bench.lines["whole bench", "safe state"].said
    assert said == "reported: source off (frame_source), head up (force_applicator)"


def test_what_cannot_be_tried_at_all_is_kept_apart(bench):
    bench.factories["load_cell"] = lambda context: raising(ConfigError("it has no option 'adress'"))()
    found = bench.look()
    assert [type(error) for error in found.refused] == [ConfigError]
    assert isinstance(found.refused[0], RefusedError)
    assert bench.lines["load_cell", "identity"].outcome is FAILED


def test_self_tests_are_lines_of_their_instrument(bench):
    bad = CheckResult("rest force", FAILED, 0.4, "N", "−0.1 to 0.1 N", "tare it")
    bench.instruments["load_cell"].self_test = lambda: (CheckResult("supply", OK, 5.0, "V"), bad)
    bench.instruments["frame_source"].self_test = raising(InstrumentError("frame_source", "COM1", "fell silent"))
    bench.look()
    assert bench.lines["load_cell", "supply"].outcome is OK
    assert bench.lines["load_cell", "rest force"] == replace(bad, subject="load_cell")
    assert bench.lines["frame_source", "self-test"].outcome is FAILED
    assert "fell silent" in bench.lines["frame_source", "self-test"].said


@pytest.mark.parametrize(("policy", "outcome"), [("warn", WARNING), ("refuse", FAILED)])
def test_calibration_dates_are_held_against_the_stations_policy(simulated, policy, outcome):
    gate = GateSettings({GateCheck.CALIBRATION_DUE: GatePolicy(policy)})
    bench = Bench(simulated, gate=gate)
    bench.due(force_applicator="2026-11-21", frame_source="2026-11-22")
    bench.look()
    late, today = bench.lines["force_applicator", "calibration due"], bench.lines["frame_source", "calibration due"]
    assert (late.outcome, late.value, today.outcome, today.value) == (outcome, -1.0, OK, 0.0)
    assert late.said.startswith("due on 2026-11-21; runs")
    assert ("load_cell", "calibration due") not in bench.lines


def test_a_reference_standard_is_shown_with_its_certificate_and_date(simulated):
    bench = Bench(simulated, standards=(LOAD_CELL, replace(INDENTER, due="2026-11-21")))
    bench.look()
    load_cell = bench.lines["standards.load_cell", "calibration due"]
    indenter = bench.lines["standards.indenter", "calibration due"]
    assert (load_cell.outcome, load_cell.said) == (OK, LOAD_CELL.all_words())
    assert indenter.outcome is WARNING
    stated = "U = 0.02 mm (k = 2), certificate L-99 of D-K-15001, due 2026-11-21, drift not stated"
    assert indenter.said == f"{stated}; runs carry a warning"


def test_what_no_certificate_states_is_listed_as_not_stated(simulated):
    bench = Bench(simulated, standards=(LOAD_CELL,))
    bench.look()
    line = bench.lines["standards", "certificates"]
    assert (line.outcome, line.said) == (NOT_DONE, "not stated: indenter, stage, thermometer, source meter")


def test_a_certificate_dated_later_than_today_is_a_warning(simulated):
    bench = Bench(simulated, standards=(replace(LOAD_CELL, date="2026-11-23"),))
    bench.look()
    line = bench.lines["standards.load_cell", "calibration due"]
    assert line.outcome is WARNING
    assert (
        line.said == f"{LOAD_CELL.all_words()}; dated 2026-11-23, later than today, 2026-11-22; runs carry a warning"
    )
    assert line.remedy == "correct its date in the station file, or set the computer's clock"


def silent(bench):
    bench.script.force_N = lambda time_s, down: None


def two_heads(bench):
    bench.factories["load_cell"] = lambda context: ScriptedApplicator(bench.script)


def real(bench):
    bench.instruments["load_cell"].simulated = False


def stuck(bench):
    bench.script.on("force_applicator.safe_state", raising(InstrumentError("force_applicator", "COM2", "is stuck")))


FAULTS = {
    "a channel without samples": (silent, ("load_cell", "samples of force"), "no sample in 2 s", True),
    "no load cell": (two_heads, ("whole bench", "together"), "provide 'force', which is neither a role", False),
    "a real instrument on a virtual clock": (
        real,
        ("whole bench", "together"),
        "load_cell is a real instrument",
        False,
    ),
    "no safe state": (stuck, ("whole bench", "safe state"), "is stuck", True),
}


@pytest.mark.parametrize(("spoil", "line", "said", "measured"), FAULTS.values(), ids=FAULTS)
def test_a_fault_of_the_bench_is_a_line_that_fails(bench, spoil, line, said, measured):
    """Where instruments do not work together, the ring is not measured."""
    spoil(bench)
    bench.look(RING, lambda words: True)
    assert bench.lines[line].outcome is FAILED
    assert said in bench.lines[line].said
    assert bench.lines[line].value in (None, 0.0)
    assert ("frame_source.acquire" in bench.script.names()) is measured
    assert bench.script.count("frame_source.safe_state") == 1


@pytest.mark.parametrize(("current_A", "is_covered"), [(0.4e-3, True), (5e-3, False), (None, True)])
def test_a_current_beyond_the_source_meters_certificate_is_a_line(simulated, current_A, is_covered):
    meter = replace(LOAD_CELL, role="source_meter", certificate="Q-9", range_low=0.1, range_high=1.0)
    bench = Bench(simulated, standards=(meter,))
    frames = bench.instruments["frame_source"]
    acquire = frames.acquire
    frames.acquire = lambda count: replace(acquire(count), current_A=current_A)
    bench.look(RING, lambda words: True)
    line = bench.lines.get(("standards.source_meter", "range"))
    assert (line is None) is is_covered
    if line is not None:
        assert (line.outcome, line.said) == (FAILED, "5 mA were driven; certificate Q-9 covers 0.1 to 1 mA")


def test_on_a_real_bench_the_operator_connects_the_ring_first(bench):
    asked = []
    found = bench.look(RING, lambda words: asked.append(words) or True)
    assert asked == ["Connect the reference ring (16 resistors, 10000 Ω each) in place of the sensor"]
    assert len(found.ring.frames) == RING.frames
    assert [call.arguments for call in bench.script.calls if call.name == "frame_source.acquire"] == [(5,)]
    assert bench.lines["reference ring", "gain error"].value == pytest.approx(-100.0)  # ones are nothing but offset


@pytest.mark.parametrize("confirm", [None, lambda words: False])
def test_a_ring_nobody_has_connected_is_not_measured_which_a_transcript_is_told(bench, confirm, monkeypatch):
    told = []
    monkeypatch.setattr(Listener, "note_no_ring", lambda self: told.append("no ring"))
    assert bench.look(RING, confirm).ring is None
    assert len(told) == 1
    assert bench.lines["reference ring", "readings"].outcome is NOT_DONE
    assert "frame_source.acquire" not in bench.script.names()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InstrumentError("frame_source", "COM1", "fell silent")])
def test_whatever_ends_the_ring_the_bench_is_safe_and_closed(bench, error):
    bench.script.on("frame_source.acquire", raising(error))
    if isinstance(error, KeyboardInterrupt):
        with pytest.raises(KeyboardInterrupt):
            bench.look(RING, lambda words: True)
    else:
        bench.look(RING, lambda words: True)
        assert bench.lines["reference ring", "readings"].outcome is FAILED
    for role in ROLES:
        assert bench.script.count(f"{role}.safe_state") == 1
        assert bench.script.count(f"{role}.close") == 1


def test_a_ring_of_another_number_of_resistors_is_refused_before_anything_is_opened(bench):
    with pytest.raises(ConfigError, match="has 3 values"):
        bench.look(replace(RING, resistance_ohm=(1.0, 2.0, 3.0)))
    assert bench.script.calls == []


def test_a_strip_has_no_ring():
    strip = configure("simulated-strip", "golden-check", sensor_type=None, material=None, seed=3)
    found = look_at_bench(strip, discover(), VirtualClock(), today=TODAY, ring=RING, confirm=None)
    (line,) = [line for line in found.lines if line.subject == "reference ring"]
    assert (line.outcome, line.said.partition(" electrodes")[0]) == (NOT_DONE, "strip-40x20mm has 2")


def test_the_ring_of_a_simulated_bench_goes_through_its_leads_and_its_sheet_stays_as_it_was(simulated):
    bad_lead = {"name": "lead-resistance", "electrode": 7, "resistance_ohm": 300.0}
    (spec,) = simulated.station.instruments
    scene = {**spec.options["scene"], "effects": [*spec.options["scene"]["effects"], bad_lead]}
    station = replace(simulated.station, instruments=(replace(spec, options={"scene": scene}),))
    faulty = replace(simulated, station=station)
    found = look_at_bench(faulty, discover(), VirtualClock(), today=TODAY, ring=RING, confirm=None)
    failed = [line for line in found.lines if line.outcome is FAILED]
    assert [line.name for line in failed] == ["lead resistance"]
    assert failed[0].value == pytest.approx(300.0, rel=0.01)
    assert failed[0].said.startswith("largest at electrode 7")
    assert found.ring.resistances_ohm == (1e4,) * 16
    assert "reference_ring_ohm" not in scene["scene"]


def test_a_ring_is_put_into_the_world_behind_emulated_instruments_too(simulated):
    (spec,) = simulated.station.instruments
    emulated = replace(simulated.station, emulated_scene=dict(spec.options["scene"]), instruments=())
    ringed = with_ring(replace(simulated, station=emulated), (5.0, 6.0, 7.0)).station.emulated_scene
    assert ringed["scene"]["reference_ring_ohm"] == [5.0, 6.0, 7.0]
    assert ringed["effects"] == spec.options["scene"]["effects"]


class Scanner(ScriptedFrames):
    """Frames through another instrument: who it is, it knows from that."""

    peers = None

    def link(self, peers):
        self.peers = peers

    def identity(self):
        return replace(super().identity(), simulated=self.peers is not None and "force" in self.peers)


def test_one_that_works_through_others_is_asked_once_it_has_them(bench):
    bench.instruments["frame_source"] = Scanner(bench.script, (16, 16), 2.5)
    found = bench.look(RING, lambda words: True)
    assert len(found.ring.frames) == RING.frames
    assert bench.lines["frame_source", "identity"].said.endswith("simulated")
    assert bench.script.count("frame_source.identity") == 1


def test_where_another_is_missing_it_is_not_asked(bench):
    bench.instruments["frame_source"] = Scanner(bench.script, (16, 16), 2.5)
    bench.factories["load_cell"] = lambda context: raising(SILENT)()
    bench.look()
    assert bench.lines["frame_source", "identity"].outcome is NOT_DONE
    assert bench.script.count("frame_source.identity") == 0
    assert bench.script.count("frame_source.close") == 1


class TellingHead(ScriptedApplicator):
    """A head that says where it is while it moves."""

    channel, unit = "head depth", "mm"

    def samples_since(self, time_s):
        return SampleBlock(self.channel, self.unit, np.zeros(0), np.zeros(0))


def test_a_head_that_does_not_move_has_no_samples_and_nothing_is_wrong_with_it(bench):
    bench.instruments["force_applicator"] = TellingHead(bench.script)
    bench.look()
    line = bench.lines["force_applicator", "samples of head depth"]
    assert (line.outcome, line.value) == (NOT_DONE, None)


def test_an_operator_who_stops_the_check_while_being_asked_ends_it_and_leaves_the_bench_safe(bench):
    bench.instruments["force_applicator"].self_test = raising(AbortedError("the operator, who answered 'stop'"))
    with pytest.raises(AbortedError):
        bench.look()
    assert [bench.script.count(f"{role}.safe_state") for role in ROLES] == [1, 1, 1]
    assert [bench.script.count(f"{role}.close") for role in ROLES] == [1, 1, 1]


def test_the_ring_is_asked_for_before_contacts_are_looked_at_and_open_pins_are_a_line(bench):
    told = []

    class Touching(Scanner):
        def link(self, peers):
            told.append("link")
            if "ring" not in told:
                raise InstrumentError("frame_source", "its pins", "pin 7 open", remedy="press it in")
            super().link(peers)

    bench.instruments["frame_source"] = Touching(bench.script, (16, 16), 2.5)
    assert bench.look(RING, lambda words: told.append("ring") or True).ring is not None
    assert told == ["ring", "link"]
    told.clear()
    assert bench.look(RING, None).ring is None
    line = bench.lines["frame_source", "together"]
    assert (line.outcome, line.remedy) == (FAILED, "press it in")
    assert "pin 7 open" in line.said
