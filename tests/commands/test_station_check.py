"""``cbsr-qa station check`` from end to end: stored, on a page, in the station's reports, with its exit codes."""

import json
import re
import signal
from dataclasses import replace
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.station_check import check as station_check, outcome
from cbsr_qa.app.station_check.bench import BenchFindings
from cbsr_qa.app.station_check.check import check_station
from cbsr_qa.app.station_check.request import CheckRequest
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.loader import load_scene, load_station
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.report.terminal import terminal_lines
from cbsr_qa.store.opening import open_store


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    """Everything is written below a folder of the test's own."""
    monkeypatch.chdir(tmp_path)
    for name in ("CBSR_QA_VAR", "CBSR_QA_DATABASE"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def check(capsys):
    """Run the command with ``--json``; returns its exit code and its document."""

    def run(*arguments):
        code = run_guarded(["station", "check", "--json", *arguments])
        return code, json.loads(capsys.readouterr().out)

    return run


def stored(station="simulated"):
    with open_store("sqlite:///var/cbsr-qa.db", create=False) as store:
        found = store.stations.read_latest_check(station)
        return found, store.stations.read_ring(found.check)


def outcomes(document):
    return {(line["subject"], line["name"]): line["outcome"] for line in document["results"]}


def lines_of(subject, document):
    return {line["name"]: line for line in document["results"] if line["subject"] == subject}


def faulty(tmp_path, effect):
    """A station like the shipped one, with something wrong in its scene, and a ring of its own."""
    scene = load_scene("base").document.text
    (tmp_path / "wrong.toml").write_text(f"{scene}\n[[effects]]\n{effect}\n")
    content = load_station("simulated").document.text.replace('scene = "base"', 'scene = "wrong.toml"')
    content = content.replace('name = "simulated"', 'name = "wrong"')
    (tmp_path / "station.toml").write_text(f"{content}\n[reference_ring]\nresistance_ohm = 20000.0\nframes = 6\n")
    return str(tmp_path / "station.toml")


def test_a_station_that_is_well_ends_with_0_and_is_stored_with_the_rings_frames(check, tmp_path):
    code, document = check("simulated", "--ring-ohm", "10000", "--operator", "Zoë")
    assert (code, document["outcome"]) == (0, "ok")
    found, ring = stored()
    assert found.check == document["check"]
    assert found.operator == "Zoë"
    assert [line.said for line in found.results] == [line["said"] for line in document["results"]]
    assert dict(found.software)["cbsr-qa"]
    assert found.instruments[0].model.startswith("simulated bench")
    assert (len(ring.frames), ring.resistances_ohm) == (16, (1e4,) * 16)
    ohm = lines_of("reference ring", document)
    assert abs(ohm["gain error"]["value"]) < 0.01
    # The noise of the 8 wt% material is 1.9e-4 of the sheet's mean reading, and the ring reads 0.25 V.
    assert ohm["noise of a reading"]["value"] == pytest.approx(380, rel=0.05)
    page = (tmp_path / document["page"]).read_text()
    assert "Readings over" not in page
    assert "<svg" in page
    assert "16 resistors of 10.0\N{NO-BREAK SPACE}kΩ, 16 frames at 400\N{NO-BREAK SPACE}µA" in page
    assert not list((tmp_path / "var" / "calibrations").iterdir())


@pytest.mark.rest
@pytest.mark.parametrize(
    ("effect", "name", "value"),
    [
        ('name = "reading-offset"\noffset_V = 0.004', "offset", 4.0),
        ('name = "lead-resistance"\nelectrode = 7\nresistance_ohm = 250.0', "lead resistance", 250.0),
    ],
)
def test_what_is_wrong_with_a_station_fails_and_is_in_the_reports_it_writes(
    check, tmp_path, capsys, effect, name, value
):
    station = faulty(tmp_path, effect)
    code, document = check(station)
    failed = {line["name"]: line for line in document["results"] if line["outcome"] == "failed"}
    assert code == 1
    assert list(failed) == [name]
    assert failed[name]["value"] == pytest.approx(value, rel=0.02)
    assert failed[name]["remedy"]
    assert len(stored("wrong")[1].frames) == 6

    assert run_guarded(["run", "--station", station, "--recipe", "golden-check", "--serial", "S-1", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    page = (tmp_path / report).read_text()
    said = re.search(r"Station wrong was last checked less than a minute before this run began[^<]*", page)[0]
    assert said.endswith(": of 11 checks, 1 failed.")
    assert f"reference ring, {name}: failed. What to do: {failed[name]['remedy']}" in page.replace("&#39;", "'")


@pytest.mark.rest
def test_reports_of_a_station_that_was_never_checked_say_so_also_when_they_are_written_again(tmp_path, capsys, check):
    arguments = ["--station", "simulated", "--recipe", "golden-check", "--serial", "S-1", "--json"]
    assert run_guarded(["run", *arguments]) == 0
    first = json.loads(capsys.readouterr().out)
    words = "Station simulated had never been checked when this run began"
    assert words in (tmp_path / first["report"]).read_text()
    assert check("simulated", "--no-ring")[0] == 0
    # A check of after the run says nothing of how the station stood when it was made.
    assert run_guarded(["report", first["run"], "--json"]) == 0
    capsys.readouterr()
    assert words in (tmp_path / first["report"]).read_text()


@pytest.mark.rest
def test_a_golden_sensor_is_run_and_held_against_its_history(check, tmp_path):
    documents = [check("simulated", "--no-ring", "--golden", "G-1") for _ in range(3)]
    assert [code for code, _ in documents] == [0] * 3
    last = lines_of("golden sensor G-1", documents[-1][1])
    assert last["history"]["said"] == "2 earlier runs at this station, 0 at others"
    assert last["history"]["outcome"] == last["force"]["outcome"] == "not done"
    assert last["force"]["value"] == pytest.approx(3.6, abs=0.1)
    found, ring = stored()
    assert (found.golden_run, ring) == (documents[-1][1]["golden_run"], None)
    with open_store("sqlite:///var/cbsr-qa.db", create=False) as store:
        assert len(store.runs.find("G-1")) == 3
        assert store.runs.read_identity(found.golden_run).recipe == "golden-check"
    # Another station, whose load cell is at its limit: it is not like the others, whatever it thinks of itself.
    wrong = faulty(tmp_path, 'name = "load-cell-saturation"\nlimit_N = 2.0')
    code, document = check(wrong, "--no-ring", "--golden", "G-1")
    assert code == 1
    force = lines_of("golden sensor G-1", document)["force"]
    assert (force["outcome"], force["value"]) == ("failed", None)  # a cell at its limit measures nothing
    assert force["said"] == "it could not be measured in this run; 3 earlier runs had it"
    amplitude = lines_of("golden sensor G-1", document)["amplitude response"]
    assert amplitude["allowed"].endswith(" (simulated)")
    assert amplitude["outcome"] == "ok"


def test_words_fit_the_terminal_and_name_what_to_do(tmp_path, capsys):
    assert run_guarded(["station", "check", faulty(tmp_path, 'name = "reading-offset"\noffset_V = 0.004')]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0] == "✗ FAILED: reference ring: offset"
    assert any("What to do: zero the meter" in line for line in said)
    assert max(map(len, said)) <= 130


def test_long_allowances_and_findings_are_wrapped_and_nothing_is_lost():
    line = CheckResult(
        "force",
        CheckOutcome.FAILED,
        3.9,
        "N",
        "3.5474 to 3.6827 N (here); 3.5111 to 3.7001 N (bench-2, bench-3, bench-with-a-long-name)",
        "measure it again",
        "here 3.615 ± 0.009 in 6 earlier runs; bench-3, bench-with-a-long-name 3.606 ± 0.012 in 9 earlier runs",
        "golden sensor G-1",
    )
    found = outcome.check_outcome(replace(CHECK, results=(line,)), None, None, None)
    lines = list(terminal_lines(found.page, found.sections))
    rows = [text for text in lines if text.startswith("    ")]
    said = " ".join(rows)
    for word in (*line.allowed.split(), *line.said.split(), "What", *line.remedy.split()):
        assert word in said or word in " ".join(lines)
    assert max(map(len, rows)) <= 140
    assert found.exit_code == 3  # no instrument answered


CHECK = StationCheck("1", "simulated", "", datetime(2026, 11, 22, tzinfo=UTC), "disc-100mm", 64 * "a", (), (), ())


class Silent:
    """The installed plugins, whose instruments do not answer."""

    def __init__(self, error):
        self.error, self.installed = error, discover()

    def __getattr__(self, name):
        return getattr(self.installed, name)

    def factory(self, kind, name):
        def opened(context, **options):
            raise self.error

        return opened if kind is Kind.INSTRUMENT else self.installed.factory(kind, name)


def test_where_no_instrument_answers_it_ends_with_3_and_says_so_in_a_stored_check(check, monkeypatch):
    error = InstrumentError("bench", "COM3", "does not answer", remedy="switch it on")
    monkeypatch.setattr(station_check, "discover", lambda: Silent(error))
    code, document = check("simulated", "--golden", "G-1")
    assert code == 3
    assert outcomes(document)["bench", "identity"] == "failed"
    assert outcomes(document)["golden sensor G-1", "run"] == "not done"
    assert stored()[0].outcome is CheckOutcome.FAILED


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "nowhere"),
        (["simulated", "--golden", "../G"], "serial"),
        (["simulated", "--ring-ohm", "-5"], "--ring-ohm is -5"),
        (["simulated", "--ring-ohm", "5", "--no-ring"], "beside --no-ring"),
    ],
)
def test_what_is_wrong_with_the_question_is_refused_and_nothing_is_written(check, tmp_path, arguments, said):
    code, document = check(*arguments)
    assert code == 2
    assert said in document["refused"]["reason"]
    assert list(tmp_path.iterdir()) == []


def test_ring_and_golden_sensor_at_once_are_refused_where_nobody_can_exchange_them(check, tmp_path):
    content = load_station("simulated").document.text.replace('scene = "base"', "")
    (tmp_path / "real.toml").write_text(content)
    code, document = check("real.toml", "--golden", "G-1", "--ring-ohm", "5", "--ring-connected")
    assert code == 2
    assert "cannot both be connected" in document["refused"]["reason"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_the_first_signal_ends_a_check_and_a_second_waits_until_the_bench_is_safe(monkeypatch, name):
    safe = []

    def stopped(*arguments, **options):
        try:
            signal.raise_signal(getattr(signal, name))
        finally:
            signal.raise_signal(signal.SIGINT)  # somebody is impatient
            safe.append(name)

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(station_check, "look_at_bench", stopped)
    assert run_guarded(["station", "check", "simulated"]) == 3
    assert safe == [name]
    assert signal.getsignal(signal.SIGTERM) is before
    with open_store("sqlite:///var/cbsr-qa.db", create=False) as store:
        assert store.stations.read_latest_check("simulated") is None


@pytest.mark.parametrize("ring", [True, False])
def test_on_a_real_bench_what_must_be_connected_is_asked_for_before_contacts_are_looked_at(monkeypatch, ring):
    told = []

    def looked(*arguments, ring, confirm, **options):
        told.append("look")
        if ring is not None:
            confirm("Connect the reference ring")
        return BenchFindings([CheckResult("identity", CheckOutcome.OK)], [SimpleNamespace(simulated=False)])

    monkeypatch.setattr(station_check, "look_at_bench", looked)
    monkeypatch.setattr(station_check, "simulates_frames", lambda station: False)
    monkeypatch.setattr(station_check, "run_golden", lambda *arguments: told.append("golden run"))
    monkeypatch.setattr(station_check, "_compose_check", lambda *arguments: CHECK)
    asked = CheckRequest("simulated", golden="G-1", ring_ohm=1e4 if ring else None)

    class Confirming(Unattended):
        attended = True

        def ask(self, text):
            told.append(text.partition(".")[0])
            return ""

    check_station(asked, Confirming())
    place = "Put golden sensor G-1 on the station"
    assert told == (
        ["look", "Connect the reference ring", place, "golden run"] if ring else [place, "look", "golden run"]
    )


def test_a_scene_that_is_wrong_is_refused_like_that_of_a_run(check, tmp_path):
    code, document = check(faulty(tmp_path, 'name = "reading-ofset"\noffset_V = 1.0'))
    assert code == 2
    assert "reading-ofset" in document["refused"]["reason"]
