"""Every check of the gate passes, warns, refuses and is off where it should, on real databases."""

import json
import threading
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta

import pytest
from calibration_samples import LOAD_CELL
from kept_batches import keep_sample
from stored_lots import judged, store_run
from stored_runs import identity, journalled, short_run

from cbsr_qa.app.gate.gate import ask_gate, gate_refusal
from cbsr_qa.app.gate.people import asks_pin
from cbsr_qa.app.gate.release_list import list_releases
from cbsr_qa.app.gate.releases import ReleaseRequest, release_file
from cbsr_qa.app.gate.request import GateRequest, Override
from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type, load_station
from cbsr_qa.config.merging import add_batch_model, merge
from cbsr_qa.config.paths import batch_file
from cbsr_qa.config.serials import read_parts
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy, GateSettings, Operator
from cbsr_qa.domain.plan.limits import FailureCode, Limit, Outcome
from cbsr_qa.domain.plan.plan import SyncSettings
from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.gate import GateOutcome
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, StationCheck
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Veto, hookimpl
from cbsr_qa.store.engine import writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.pins import hash_pin, pin_matches

STATION = "bench-α"
LIMITS = {"drift": Limit("drift", "%/min", -0.5, 0.5)}
GOOD, BAD = (judged((Measurement("drift", value, "%/min"),), LIMITS) for value in (0.1, 0.9))


@pytest.fixture(scope="module")
def plugins():
    return discover()


@pytest.fixture(scope="module")
def merged():
    parts = load_station("simulated"), load_recipe("nine-locations"), load_sensor_type("disc-100mm")
    return merge(*parts, load_material("cbsr-8wt"), seed=1)


@pytest.fixture
def store(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as opened:
        yield opened


@pytest.fixture
def ask(tmp_path, merged, plugins, store):
    """Ask one check; returns its answer."""

    def one(check, policy="refuse", *, configuration=None, plugins=plugins, asked=None, store=store, **settings):
        of = configuration or merged
        gate = GateSettings({GateCheck(check): GatePolicy(policy)}, **settings)
        station = replace(of.station, name=STATION, gate=gate)
        of = replace(of, station=station, recipe=replace(of.recipe, name="short"))
        request = GateRequest("S-1", f"sqlite:///{tmp_path / 'runs.db'}", (tmp_path,), **(asked or {}))
        (answer,) = ask_gate(request, of, plugins, store, [GateCheck(check)])
        assert "cbsr-qa " not in answer.remedy  # a page shows it: command lines are apart
        assert "--" not in answer.remedy
        return answer

    return one


@pytest.mark.parametrize(
    ("policy", "outcome"), [("refuse", GateOutcome.REFUSED), ("warn", GateOutcome.WARNED), ("off", GateOutcome.OFF)]
)
def test_what_follows_is_the_stations_policy(ask, policy, outcome):
    answer = ask("operator", policy, operators=(Operator("Ada"),))
    assert answer.outcome is outcome
    refusal = gate_refusal([answer])
    assert (refusal is not None) is (policy == "refuse")
    if refusal is not None:
        assert "--override operator" in refusal.remedy


def test_an_override_states_who_and_why_and_only_of_what_would_refuse(ask):
    override = Override(("operator",), "Grace", "night shift").validate()
    answer = ask("operator", asked={"override": override}, operators=(Operator("Ada"),))
    assert (answer.outcome, answer.by, answer.why) == (GateOutcome.OVERRIDDEN, "Grace", "night shift")
    assert gate_refusal([answer]) is None
    known = ask("operator", asked={"override": override, "operator": "Ada"}, operators=(Operator("Ada"),))
    assert (known.outcome, known.by) == (GateOutcome.PASSED, "")


@pytest.mark.parametrize(
    ("override", "named"),
    [
        (Override(("goldem",), "A", "b"), "did you mean 'golden'"),
        (Override(("golden",), "", "b"), "--override-by"),
        (Override(("golden",), "A", " "), "--override-why"),
        (Override((), "A", "b"), "needs --override"),
        (Override(("golden",), "A\x1b[2J", "b"), "is not allowed"),
    ],
)
def test_an_override_that_is_not_whole_is_refused(override, named):
    with pytest.raises(ConfigError, match=named):
        override.validate()


@pytest.mark.parametrize(
    ("pattern", "serial", "outcome"),
    [
        ("", "S-1", GateOutcome.OFF),
        ("S-[0-9]+", "S-1", GateOutcome.PASSED),
        ("[0-9]+", "S-1", GateOutcome.REFUSED),  # in full, not somewhere
        ("(([A-Za-z]+)*)*[0-9]", "a" * 64, GateOutcome.REFUSED),  # Python's re does not end
    ],
)
def test_the_whole_serial_number_fits_the_pattern(merged, plugins, pattern, serial, outcome):
    request = GateRequest(serial, "sqlite:///none.db", ())
    of = replace(merged, serial_pattern=pattern)
    (answer,) = ask_gate(request, of, plugins, None, [GateCheck.SERIAL_PATTERN])
    assert answer.outcome is outcome


def test_a_sensor_that_passed_is_not_tested_again_unless_that_was_overridden(ask, store):
    assert ask("retest", store=None).outcome is GateOutcome.PASSED
    run = store_run(store, "S-1", GOOD)
    assert run in ask("retest").words
    store.changes.override_verdict(run, Outcome.FAIL, operator="Zoë", why="scratched")
    assert ask("retest").outcome is GateOutcome.PASSED


def test_finished_runs_of_sensor_and_recipe_count_and_no_others(ask, store):
    store_run(store, "S-1", BAD, end=EndReason.ABORTED)
    store_run(store, "S-2", BAD)
    store_run(store, "S-1", GOOD, recipe="another")
    measured_golden(store, store_run(store, "S-1", GOOD))
    assert ask("retest", retest_runs=1).words == "0 finished runs of S-1 with short, at most 1 allowed"
    store_run(store, "S-1", BAD)
    assert ask("retest", retest_runs=2).outcome is GateOutcome.PASSED
    refused = ask("retest", retest_runs=1)
    assert (refused.outcome, refused.words) == (
        GateOutcome.REFUSED,
        "1 finished run of S-1 with short; no more than 1 allowed, so it may not be tested again",
    )
    assert ask("retest", retest_runs=1, asked={"golden": True}).outcome is GateOutcome.OFF


def test_a_finished_run_without_a_result_counts_and_is_named(ask, store):
    run = store.new_id()
    journalled(store, short_run(run))
    count = (
        f"1 finished run of S-1 with short, run {run} without a result yet (cbsr-qa run --resume {run} computes it)"
    )
    assert ask("retest", retest_runs=2).words == f"{count}, at most 2 allowed"
    assert ask("retest", retest_runs=1).outcome is GateOutcome.REFUSED


def test_an_instrument_is_in_time_until_the_end_of_its_day(ask, merged):
    today = datetime.now(UTC).date()
    for days, outcome in ((0, GateOutcome.PASSED), (-1, GateOutcome.WARNED)):
        (spec,) = merged.station.instruments
        late = replace(spec, calibration_due=(today + timedelta(days=days)).isoformat())
        of = replace(merged, station=replace(merged.station, instruments=(late,)))
        assert ask("calibration_due", "warn", configuration=of).outcome is outcome


def test_a_reference_standard_is_in_time_until_the_end_of_its_day(ask, merged):
    today = datetime.now(UTC).date()
    for days, outcome in ((0, GateOutcome.PASSED), (-1, GateOutcome.REFUSED)):
        due = (today + timedelta(days=days)).isoformat()
        of = replace(merged, station=replace(merged.station, standards=(replace(LOAD_CELL, due=due),)))
        answer = ask("calibration_due", "refuse", configuration=of)
        assert answer.outcome is outcome
        if days < 0:
            assert f"the calibration of the load cell (certificate K-2026-0711) was due on {due}" in answer.words


def test_a_certificate_dated_later_than_today_is_named(ask, merged):
    today = datetime.now(UTC).date()
    for days, outcome in ((0, GateOutcome.PASSED), (1, GateOutcome.REFUSED)):
        day = (today + timedelta(days=days)).isoformat()
        due = (today + timedelta(days=400)).isoformat()
        of = replace(merged, station=replace(merged.station, standards=(replace(LOAD_CELL, date=day, due=due),)))
        answer = ask("calibration_due", "refuse", configuration=of)
        assert answer.outcome is outcome
        if days:
            assert f"the certificate K-2026-0711 of the load cell is dated {day}, later than today" in answer.words


def measured_golden(store, run, *, ago=timedelta(), outcome=CheckOutcome.OK):
    line = CheckResult("force", outcome, subject="golden sensor G-1")
    ring = CheckResult("gain error", CheckOutcome.FAILED, subject="reference ring")
    at = datetime.now(UTC) - ago
    check = StationCheck(store.new_id(), STATION, "Zoë", at, "disc-100mm", 64 * "a", (), (), (line, ring), run)
    store.stations.save_check(check)


@pytest.mark.parametrize(
    ("ago_h", "outcome", "runs", "words"),
    [
        (1, CheckOutcome.OK, 1, ""),
        (1, CheckOutcome.WARNING, 1, ""),
        (25, CheckOutcome.OK, 0, "was measured 25.0 h ago; the station allows 24 h"),
        (-1, CheckOutcome.OK, 0, "is later than this computer's clock"),
        (1, CheckOutcome.FAILED, 0, "did not pass: failed"),
        (1, CheckOutcome.OK, 2, "was measured 2 or more runs ago"),
    ],
)
def test_a_golden_sensor_was_measured_not_long_ago_and_passed(ask, store, ago_h, outcome, runs, words):
    limits = {"golden_hours": 24.0, "golden_runs": 2}
    assert "ever" in ask("golden", store=None, **limits).words
    assert "ever" in ask("golden", **limits).words
    measured_golden(
        store, store_run(store, "G-1", GOOD, station=STATION), ago=timedelta(hours=ago_h), outcome=outcome
    )
    for number in range(runs):
        store_run(store, f"S-{number + 2}", GOOD, station=STATION)
    answer = ask("golden", **limits)
    assert answer.outcome is (GateOutcome.REFUSED if words else GateOutcome.PASSED)
    assert words in answer.words
    assert ask("golden", asked={"golden": True}, **limits).outcome is GateOutcome.OFF


@pytest.mark.parametrize(("mean", "outcome"), [(0.1, GateOutcome.PASSED), (9.0, GateOutcome.REFUSED)])
def test_no_chart_of_the_station_signals(ask, store, mean, outcome):
    assert "no control chart" in ask("charts").words
    first = store_run(store, "S-2", GOOD, station=STATION)
    reference = ChartReference(
        reference=store.new_id(),
        **{"station": STATION, "recipe": "short", "golden": None, "name": "drift", "unit": "%/min"},
        **{"mean": mean, "deviation": 0.1, "runs": 1, "first_run": first, "last_run": first},
        **{"operator": "Zoë", "made_at": datetime.now(UTC), "why": "first lot"},
    )
    store.charts.save([reference])
    store_run(store, "S-3", GOOD, station=STATION)
    answer = ask("charts")
    assert answer.outcome is outcome
    assert ("signals since" in answer.words) is (outcome is GateOutcome.REFUSED)


def test_there_is_space_for_the_run(ask):
    estimated = ask("disk")
    assert estimated.outcome is GateOutcome.PASSED
    assert "the estimate for this run" in estimated.words
    refused = ask("disk", disk_GB=1e6)
    assert refused.outcome is GateOutcome.REFUSED
    assert "1000000.0 GB needed" in refused.words


def test_the_operator_is_listed_and_gives_the_pin(ask):
    listed = (Operator("Zoë Ōtani", hash_pin("4711")), Operator("Ada"))
    for pin, outcome in (("4711", GateOutcome.PASSED), ("4712", GateOutcome.REFUSED), ("", GateOutcome.REFUSED)):
        asked = {"operator": "Zoë Ōtani", "pin": lambda text, pin=pin: pin}
        answer = ask("operator", asked=asked, operators=listed)
        assert answer.outcome is outcome
        assert "471" not in repr(answer)
    assert ask("operator", asked={"operator": "Zoë Ōtani"}, operators=listed).outcome is GateOutcome.REFUSED
    for name, asked in (("Zoë Ōtani", {"preview": True}), ("Ada", {})):
        assert ask("operator", asked={"operator": name, **asked}, operators=listed).outcome is GateOutcome.PASSED
    assert "Eve is not on the list" in ask("operator", asked={"operator": "Eve"}, operators=listed).words
    assert "--station" in ask("operator", asked={"operator": "Ada", "resumed": True}).command
    assert listed[0].pin not in repr(listed)
    asks = {policy: GateSettings({GateCheck.OPERATOR: policy}, operators=listed) for policy in GatePolicy}
    assert asks_pin(asks[GatePolicy.REFUSE], "Zoë Ōtani")
    assert asks_pin(asks[GatePolicy.WARN], "Zoë Ōtani")
    assert not asks_pin(asks[GatePolicy.OFF], "Zoë Ōtani")
    assert not any(asks_pin(asks[GatePolicy.REFUSE], name) for name in ("Ada", "Eve", ""))


def test_a_pin_has_a_salt_and_no_hash_costs_more_than_a_station_can_pay():
    one, other = hash_pin("12345678"), hash_pin("12345678")
    assert one != other
    assert pin_matches("12345678", one)
    assert pin_matches("12345678", other)
    assert not pin_matches("12345678", one.replace("scrypt:14", "scrypt:40"))
    assert not pin_matches("1" * 100_000, one)


def test_files_are_released_by_their_content_until_that_is_withdrawn(ask, store, merged, tmp_path):
    database = f"sqlite:///{tmp_path / 'runs.db'}"
    own = tmp_path / "own.toml"
    own.write_text(load_recipe("nine-locations").document.text)
    assert ask("released").words.count("not released") == 5
    for file in ("simulated", str(own), "disc-100mm", "cbsr-8wt", "base"):
        release_file(ReleaseRequest(file, "Grace", "qualified", database=database))
    assert ask("released").words == "all 5 files are released"
    own.write_text(own.read_text() + "\n# a comment\n")
    again = release_file(ReleaseRequest(str(own), "Grace", "unusable", withdraw=True, database=database)).result
    assert (again.action, again.before.action) == ("withdrawn", "released")
    answer = ask("released")
    assert answer.outcome is GateOutcome.REFUSED
    assert "recipe nine-locations (withdrawn by Grace" in answer.words
    shown = list_releases(database)
    assert [(one.name, one.action, one.holds) for one in shown.result.releases] == [
        ("simulated", "released", True),
        ("nine-locations", "released", False),
        ("disc-100mm", "released", True),
        ("cbsr-8wt", "released", True),
        ("base", "released", True),
        ("nine-locations", "withdrawn", True),
    ]
    assert shown.page.banner.headline == "4 contents released"
    with pytest.raises(ConfigError, match="is not released"):
        release_file(ReleaseRequest(str(own), "Grace", "twice", withdraw=True, database=database))


def test_a_batch_s_model_is_released_like_the_other_files(ask, store, merged, tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    database = f"sqlite:///{tmp_path / 'runs.db'}"
    kept = keep_sample()
    with_batch = add_batch_model(merged, kept)
    for file in ("simulated", "nine-locations", "disc-100mm", "cbsr-8wt", "base"):
        release_file(ReleaseRequest(file, "Grace", "qualified", database=database))
    assert ask("released").words == "all 5 files are released"
    answer = ask("released", configuration=with_batch)
    assert answer.outcome is GateOutcome.REFUSED
    assert answer.words == f"batch model 41 (not released, SHA-256 {kept.content_sha256[:12]})"
    assert "cbsr-qa release FILE --by" in answer.command
    path = batch_file("41", kept.content_sha256)
    path.parent.mkdir()
    path.write_text(json.dumps(asdict(kept)))
    assert f"cbsr-qa release {path} --by" in ask("released", configuration=with_batch).command
    released = release_file(ReleaseRequest(str(path), "Grace", "six sensors", database=database)).result
    assert (released.kind, released.name, released.sha256) == ("batch model", "41", kept.content_sha256)
    assert ask("released", configuration=with_batch).words == "all 6 files are released"
    other = add_batch_model(merged, keep_sample(level_drift=0.02))
    assert ask("released", configuration=other).words.startswith("batch model 41 (not released")
    release_file(ReleaseRequest(str(path), "Grace", "drifts", withdraw=True, database=database))
    assert "batch model 41 (withdrawn by Grace" in ask("released", configuration=with_batch).words


def test_a_changed_or_absent_model_of_a_batch_is_not_released(tmp_path):
    path = tmp_path / "model.json"
    with pytest.raises(ConfigError, match="cannot be read"):
        release_file(ReleaseRequest(str(path), "Grace", "why", database=str(tmp_path / "none.db")))
    path.write_text(json.dumps(asdict(keep_sample()) | {"head_mm": 12.0}))
    with pytest.raises(ConfigError, match="was changed"):
        release_file(ReleaseRequest(str(path), "Grace", "why", database=str(tmp_path / "none.db")))


@pytest.mark.parametrize(
    ("content", "named"),
    [(None, "does not exist"), ("[recipe", "not valid TOML"), ("[other]\na = 1\n", "is no file of a run")],
)
def test_what_is_no_sound_file_of_a_run_is_not_released(tmp_path, content, named):
    file = tmp_path / "x.toml"
    if content is not None:
        file.write_text(content)
    with pytest.raises(ConfigError, match=named):
        release_file(ReleaseRequest(str(file), "Grace", "why", database=str(tmp_path / "none.db")))
    assert not (tmp_path / "none.db").exists()


def raising(error):
    raise error


_NEVER = threading.Event()


@pytest.mark.parametrize(
    ("says", "words"),
    [
        (lambda: None, "no objection"),
        (lambda: Veto("routing", "order 4711 is on hold", "release the order"), "routing: order 4711 is on hold"),
        (lambda: Veto("a\x1b[2J", "x" * 10_000), "…"),
        (lambda: raising(OSError("no route to host")), "could not answer: OSError: no route to host"),
        (lambda: raising(SystemExit(0)), "could not answer: SystemExit"),
        (lambda: True, "answered 'bool'"),
        (_NEVER.wait, "no answer within 0.05 s"),
    ],
)
def test_a_plugin_may_veto_and_one_that_does_not_answer_has_not_agreed(ask, says, words):
    class Routing:
        @hookimpl
        def cbsr_before_run(self, sensor, station):
            assert (sensor.serial, station) == ("S-1", STATION)
            return says()

    plugins = discover()
    assert ask("before_run", plugins=plugins).outcome is GateOutcome.OFF
    plugins.add(Routing(), "plant", "1", "routing")
    answer = ask("before_run", plugins=plugins, before_run_s=0.05 if says == _NEVER.wait else 10.0)
    assert answer.outcome is (GateOutcome.PASSED if words == "no objection" else GateOutcome.REFUSED)
    assert words in answer.words
    assert answer.words.isprintable()
    assert len(answer.words) < 1000


def test_a_check_that_cannot_be_answered_has_not_passed(ask, store, tmp_path):
    run = store.new_id()
    journalled(store, short_run(run))
    assert identity(run).station == STATION
    store.close()
    with (tmp_path / "runs.db").open("r+b") as file:
        file.write(b"no database at all, whatever its name says" * 200)
    answer = ask("golden", golden_hours=1.0)
    assert answer.outcome is GateOutcome.REFUSED
    assert "could not be checked" in answer.words


def test_what_waits_too_long_for_the_central_database_refuses(ask, merged, store):
    limited = replace(merged, station=replace(merged.station, sync=SyncSettings("postgresql://centre/q", 24.0)))
    assert ask("backlog").outcome is GateOutcome.OFF
    assert ask("backlog", configuration=limited).words == "nothing waits; the station allows 24 h"
    store_run(store, "S-1", GOOD)
    assert ask("backlog", configuration=limited).outcome is GateOutcome.PASSED
    with writing(store._engine) as connection:
        connection.exec_driver_sql("UPDATE outbox SET noted_at = '2026-01-01 00:00:00'")
    refused = ask("backlog", configuration=limited)
    assert refused.outcome is GateOutcome.REFUSED
    assert "1 item waits in this database, the oldest for" in refused.words
    assert refused.command == "cbsr-qa db sync"


def test_a_golden_check_that_is_not_signed_does_not_count_where_a_key_is_set(ask, store, monkeypatch):
    measured_golden(store, store_run(store, "G-1", GOOD))
    assert ask("golden").outcome is GateOutcome.PASSED
    monkeypatch.setattr(type(store), "key_id", "k")
    answer = ask("golden")
    assert answer.outcome is not GateOutcome.PASSED
    assert "is not signed, and a signing key is set" in answer.words


def test_a_refusal_names_the_failure_code_that_the_recipe_gives_the_check(ask, merged, store):
    store_run(store, "S-1", GOOD)
    code = FailureCode("G1", "tested before", "return it", ("retest",))
    coded = replace(merged, recipe=replace(merged.recipe, failure_codes=(code,)))
    assert ask("retest", configuration=coded).words.endswith("; G1 tested before: return it")
    assert "G1" not in ask("disk", configuration=coded, disk_GB=1e9).words


def test_a_unique_part_of_another_sensor_is_named_and_a_lot_is_not(ask, merged, store):
    run = store_run(store, "S-2", GOOD, parts=["board=B9/A", "sheet=LOT7"])
    coded = replace(merged, unique_parts=("board",))
    asked = {"parts": read_parts(["board=B9/B", "sheet=LOT7"])}
    answer = ask("parts", "warn", configuration=coded, asked=asked)
    assert (answer.outcome, answer.words) == (
        GateOutcome.WARNED,
        f"board=B9/B is of sensor S-2 too (run {run})",
    )
    assert ask("parts", configuration=coded, asked=asked).outcome is GateOutcome.REFUSED
    assert ask("parts", configuration=merged, asked=asked).outcome is GateOutcome.OFF
    lot = {"parts": read_parts(["sheet=LOT7"])}
    assert ask("parts", configuration=coded, asked=lot).outcome is GateOutcome.OFF
    store_run(store, "S-1", GOOD, parts=["board=B8"])
    own = {"parts": read_parts(["board=B8"])}
    assert ask("parts", configuration=coded, asked=own).outcome is GateOutcome.PASSED
    assert ask("parts", configuration=coded, asked=own, store=None).outcome is GateOutcome.PASSED
