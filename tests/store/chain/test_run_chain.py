"""The chain of a stored run: what is changed, added or removed is refused by name, whoever reads it."""

import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from altered_runs import certificate
from calibration_samples import sample_force
from sqlalchemy import Boolean, Column, LargeBinary, MetaData, Table, create_engine
from stored_lots import judged, measured, store_run
from stored_runs import calibration, frames, identity, journalled, short_run
from tiers import REST, rest_but_named

from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.domain.errors import ConfigError, StoreError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.charts import ChartReference
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.events import RunStarted
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome
from cbsr_qa.domain.run.run import ChainState, InstrumentIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings, StationCheck
from cbsr_qa.store.chain import fleet
from cbsr_qa.store.chain.links import VARIABLE, SigningKey, link_digest
from cbsr_qa.store.chain.run_documents import KEYS, documents, list_covered, row_text
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.reanalyses import Reanalysis
from cbsr_qa.store.tables.runs import Base
from cbsr_qa.store.types import FiniteDouble, Whole

KEY, OTHER = "a key of twenty-two let", "another key of some length"
LIMIT = Limit("drift", "mm", None, 5.0)
MEASURED = (
    Measurement("drift", 4.0, "mm", phase="nine locations").judge(LIMIT),
    Measurement("noise", -0.0, "1", 0.1 + 0.2),
)


ANSWER = GateAnswer(GateCheck.DISK, GatePolicy.REFUSE, GateOutcome.OVERRIDDEN, "1 GB free", "tidy up", "Zoë", "so")


def filled(url):
    """Store a run with something in every table, and a second one; return the first."""
    with open_store(url) as store:
        first, second = store.new_id(), store.new_id()
        journalled(store, short_run(first), gate=[ANSWER])
        journalled(store, short_run(second, "S-2"))
        record = store.runs.load(first)
        issued = calibration(store.new_id(), first)
        model = sample_force(int(issued.reconstruction.problem.used.sum()))
        issued = stamp(replace(issued, force=model, digest="", record_digest=""))
        software = (("cbsr-qa", "0.2.0"),)
        again = Reanalysis(first, 64 * "0", "{}", software, decide(MEASURED), MEASURED, ("one",), "equal", None, ())
        store.reanalyses.adopt(store.reanalyses.save(again), operator="Zoë", why="corrected")
        store.analyses.save(
            RunResult(record, None, MEASURED, decide(MEASURED), issued, "", warnings=("one\0", "two"))
        )
        store.changes.override_verdict(first, Outcome.FAIL, operator="Zoë", why="seen")
        store.certificates.save(certificate(first, issued.calibration))
        store.certificates.revoke("LAB-1", operator="Zoë", why="wrong head")
    return first


@pytest.fixture(scope="module", params=["", pytest.param(KEY, marks=REST)], ids=["not signed", "signed"])
def stored(request, tmp_path_factory):
    """A database file, its key, and the run in it."""
    file = tmp_path_factory.mktemp("chain") / "runs.db"
    with pytest.MonkeyPatch.context() as patch:
        if request.param:
            patch.setenv(VARIABLE, request.param)
        run = filled(f"sqlite:///{file}")
    return file, request.param, run


@pytest.fixture
def copied(stored, tmp_path, monkeypatch):
    """A copy to change: path and run; the key it was signed with is set."""
    file, key, run = stored
    with sqlite3.connect(file) as source, sqlite3.connect(tmp_path / "runs.db") as target:
        source.backup(target)
    if key:
        monkeypatch.setenv(VARIABLE, key)
    return tmp_path / "runs.db", run


def edit(path, statements, run):
    with sqlite3.connect(path) as database:
        for statement in statements.split(";"):
            assert database.execute(statement.replace(":run", f"'{run}'")).rowcount >= 1, statement


EDITS = {
    "configuration": (
        "update runs set configuration = replace(configuration, 'Δρ', 'Δσ')",
        "its configuration is not the one it was begun with",
    ),
    "configuration and digest": (
        "update runs set configuration = '{}', configuration_digest ="
        " '44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a' where run = :run",
        "runs was changed",
    ),
    "batch": ("update runs set batch = 'B8'", "runs was changed"),
    "a head": ("update runs set setting = replace(setting, '13.0', '14.0')", "runs was changed"),
    "an instrument": ("update instruments set serial = '124' where position = 0", "instruments was changed"),
    "an instrument less": ("delete from instruments where position = 1", "instruments was changed"),
    "how it ended": ("update run_states set detail = 'x' where number = 1", r"run_states \(number 1\) was changed"),
    "a phase": ("update phases set role = 'noise' where phase = 1", r"phases \(phase 1\) was changed"),
    "the end of a phase": (
        "update phase_ends set ended_s = 156 where phase = 0",
        r"phase_ends \(phase 0\) was changed",
    ),
    "no end of a phase": (
        "delete from phase_ends where phase = 1",
        r"phase_ends \(phase 1\) was removed",
    ),
    "a step": ("update steps set time_s = 31 where entry = 2", r"steps \(phase 0, entry 2\) was changed"),
    "a frame": (
        "update frame_blocks set voltages = zeroblob(length(voltages)) where phase = 0 and block = 1",
        "frame block 1 of phase 0 of run .* its digest does not match",
    ),
    "a frame's digest": (
        "update frame_blocks set sha256 = zeroblob(32) where phase = 0 and block = 1",
        r"frame_blocks \(phase 0, block 1\) was changed",
    ),
    "a sample": (
        "update sample_blocks set sample_values = zeroblob(length(sample_values)) where block = 1",
        "sample block 1 of phase 0 of run .* its digest does not match",
    ),
    "a load's place": ("update loads set x_mm = 15.5", r"loads \(phase 0, load_index 0\) was changed"),
    "a load less": ("delete from loads where run = :run", r"loads \(phase 0, load_index 0\) was removed"),
    "a load more": (
        "insert into loads select run, phase, 1, label, x_mm, y_mm, strain, trial, press_start_s, hold_start_s,"
        " release_start_s, release_end_s, rest_end_s, clear_s, eased from loads where run = :run",
        r"loads \(phase 0, load_index 1\) was added",
    ),
    "a mark": ("update unloaded_marks set time_s = 3.5", r"unloaded_marks \(phase 0, mark 0\) was changed"),
    "rows swapped": (
        "update frame_blocks set block = 9 where phase = 0 and block = 0;"
        "update frame_blocks set block = 0 where phase = 0 and block = 1;"
        "update frame_blocks set block = 1 where phase = 0 and block = 9",
        r"frame_blocks \(phase 0, block [01]\) was changed",
    ),
    "an outcome": ("update measurements set outcome = 'fail' where number = 0", "measurements .* was changed"),
    "a limit": ("update measurements set upper_limit = 9 where number = 0", "measurements .* was changed"),
    "the last bit": ("update measurements set uncertainty = 0.3 where number = 1", "measurements .* was changed"),
    "a measurement less": ("delete from measurements where number = 1", "measurements .* was changed"),
    "no measurement": ("delete from measurements", "measurements .* was removed"),
    "a verdict": ("update analyses set outcome = 'marginal'", "analyses .* was changed"),
    "a warning": ("update warnings set text = '' where number = 0", "warnings .* was changed"),
    "a calibration": ("update calibrations set record_sha256 = content_sha256", "calibrations .* was changed"),
    "a calibration's file": ("update calibrations set file_sha256 = content_sha256", "calibrations .* was changed"),
    "a baseline": (
        "update calibration_baselines set value = 1 where number = 0",
        "calibration_baselines .* was changed",
    ),
    "a certificate": ("update certificates set valid_until = '2099-01-01'", "certificates .* was changed"),
    "a revocation": ("update certificate_withdrawals set why = 'none'", "certificate_withdrawals .* was changed"),
    "no revocation": ("delete from certificate_withdrawals", "certificate_withdrawals .* was removed"),
    "an override": ("update verdict_overrides set outcome = 'pass'", "verdict_overrides .* was changed"),
    "a re-analysis": ("update reanalyses set outcome = 'fail'", "reanalyses .* was changed"),
    "a value of a re-analysis": (
        "update reanalyses set measurements = replace(measurements, '4.0', '3.0')",
        "reanalyses .* was changed",
    ),
    "who adopted it": ("update adoptions set operator = 'Ada'", "adoptions .* was changed"),
    "no override": ("delete from verdict_overrides", "verdict_overrides .* was removed"),
    "a link less": ("delete from run_links where number = 7", "link 7 in run_links is missing"),
    "the first link": ("delete from run_links where number = 0", "link 0 in run_links is missing"),
    "the last link": (
        "delete from run_links where run = :run and number = (select max(number) from run_links where run = :run)",
        "certificate_withdrawals .* was added",
    ),
    "no links": ("delete from run_links", "run_links holds no link"),
    "no chain": ("update runs set chain = null", "states no chain, and run_links holds links"),
    "links swapped": (
        "update run_links set number = 99 where number = 4; update run_links set number = 4 where number = 5;"
        "update run_links set number = 5 where number = 99",
        "link 4 in run_links.* does not follow",
    ),
    "a link's content": ("update run_links set content_sha256 = sha256", "link .* in run_links.* does not follow"),
    "text for a number": ("update loads set x_mm = 'far'", r"loads\.x_mm \("),
    "bytes for a number": ("update loads set x_mm = cast(x_mm as blob)", r"loads\.x_mm \("),
    "a part of a whole number": ("update warnings set number = number + 0.25", r"warnings\.number \("),
    "an endless whole number": ("update loads set trial = 9e999", r"loads\.trial \("),
    "truer than true": ("update measurements set limited = 2 where limited", "measurements .* was changed"),
    "bytes for the chain": ("update runs set chain = x'ff006a'", r"runs\.chain .* holds b'"),
    "bytes for the configuration": ("update runs set configuration = x'ff006a'", r"runs\.configuration .* holds b'"),
    "bytes for a link": ("update run_links set content_sha256 = x'ff006a' where number = 4", "content_sha256"),
    "an invalid date": ("update runs set started_at = 'now'", "runs.started_at .* holds 'now'"),
}


#: A cell, a row less, one more and two exchanged; a digest; a link less, more, exchanged; a cell of another type.
QUICK = (
    *("configuration", "batch", "an instrument less", "a load more", "rows swapped", "a frame", "a frame's digest"),
    *("the last bit", "a verdict", "no override", "a link less", "the last link", "no links", "no chain"),
    *("links swapped", "a link's content", "text for a number", "truer than true", "an invalid date"),
)


@pytest.mark.parametrize(("statement", "said"), rest_but_named(EDITS, *QUICK))
def test_an_edit_is_refused_by_name(copied, statement, said):
    path, run = copied
    edit(path, statement, run)
    with open_store(f"sqlite:///{path}") as store, pytest.raises(StoreError, match=said) as refused:
        store.runs.load(run)
    assert run in refused.value.reason


READ_ALL = (
    lambda store, run: store.runs.load(run),
    lambda store, run: store.runs.find(),
    lambda store, run: store.analyses.load(run),
    lambda store, run: store.changes.list_overrides(run),
    lambda store, run: store.calibrations.list_issued("S-1"),
    lambda store, run: store.certificates.list_all(),
    lambda store, run: store.stations.read_latest_check("bench-α"),
    lambda store, run: store.stations.read_ring("check"),
    lambda store, run: store.charts.read_all(),
)


#: Nothing is stored in these here, or nobody reads it.
EMPTY = (
    *("sensors", "configuration_changes", "releases", "archives", "outbox", "sync_accepts", "sync_refusals"),
    *("sync_settlements", "runs_begun"),
)


def add_checks(store, run):
    at = datetime(2026, 11, 22, 6, 30, tzinfo=UTC)
    smu = InstrumentIdentity("source_meter", "keithley-2600", "2634B", "123", "4.0.1", False, None)
    lines = (CheckResult("gain error", CheckOutcome.FAILED, -1.5, "%", "−1 to 1 %", "adjust it", "", "ring"),)
    check = StationCheck("check", "bench-α", "Zoë", at, "disc-100mm", 64 * "a", (("cbsr-qa", "1"),), (smu,), lines)
    store.stations.save_check(check, RingReadings(frames(0.0, 4, own_times=True), (1000.0,) * 16))
    made = {"operator": "Zoë", "made_at": at, "why": "first lot"}
    of = {"station": "bench-α", "recipe": "short", "golden": None, "name": "drift", "unit": "mm"}
    period = {"mean": 4.0, "deviation": 0.1, "runs": 2, "first_run": run, "last_run": run}
    store.charts.save([ChartReference(reference=store.new_id(), **of, **period, **made)])


#: Its signatures are empty unless runs are signed.
SIGNED = pytest.param("run_links", KEY, id="run_links-signed", marks=REST)


@pytest.mark.parametrize(
    ("table", "stored"),
    [
        *(
            pytest.param(table, "", id=table, marks=() if table == "measurements" else REST)
            for table in sorted({*Base.metadata.tables} - {*EMPTY, "run_links"})
        ),
        SIGNED,
    ],
    indirect=["stored"],
)
def test_bytes_in_any_column_are_refused_with_table_and_column(copied, table):
    path, run = copied
    with open_store(f"sqlite:///{path}") as store:
        add_checks(store, run)
    whole = path.read_bytes()
    key = ", ".join(column.name for column in Base.metadata.tables[table].primary_key)
    for column in Base.metadata.tables[table].columns:
        if isinstance(column.type, LargeBinary | Boolean) or column.foreign_keys or column.name == "station":
            continue
        path.write_bytes(whole)
        with closing(sqlite3.connect(path)) as database, database:
            database.execute(
                f"update {table} set {column.name} = x'ff006a' where ({key}) in (select {key} from {table} limit 1)"
            )
        with open_store(f"sqlite:///{path}") as store:
            passed_over = f"{column.name} holds b'\\xff\\x00j', which is not a value of that column"
            named = any(
                f"{table}.{column.name} (" in reason or (reason.startswith(f"{table} (") and passed_over in reason)
                for reason in refusals(store, run)
            )
        assert named, column.name


def refusals(store, run):
    for read in READ_ALL:
        try:
            read(store, run)
        except StoreError as refused:
            yield refused.reason
    yield from store.soundness.find_odd_rows()  # of rows outside of runs: passed over, and named by db check


RUN, VALUE = "update runs set batch = 'B8' where run = :run", "update measurements set value = 1 where number = 1"
READERS = {
    "load_run": (VALUE, lambda store, run, _: store.runs.load(run)),
    "resume": (VALUE, lambda store, run, _: store.runs.check_resumable(run)),
    "configuration": (RUN, lambda store, run, _: store.runs.read_configuration(run)),
    "identity": (RUN, lambda store, run, _: store.runs.read_identity(run)),
    "analyses": (VALUE, lambda store, run, _: store.analyses.load(run)),
    "calibration": (
        "update calibrations set record_sha256 = '1'",
        lambda store, _, issued: store.calibrations.load_file(issued),
    ),
    "override": (
        VALUE,
        lambda store, run, _: store.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="so"),
    ),
    "fleet of a sensor": (VALUE, lambda store, *_: store.fleet.load_table(RunSelection(serials=("S-1",)))),
    "fleet": (RUN, lambda store, *_: store.fleet.load_table()),
}


@pytest.mark.parametrize(
    ("statement", "read"), rest_but_named(READERS, "load_run", "calibration", "override", "fleet")
)
def test_every_reader_refuses_what_it_uses(copied, statement, read):
    path, run = copied
    with open_store(f"sqlite:///{path}") as store:
        again = RunResult(store.runs.load(run), None, MEASURED, decide(MEASURED), None, "")
        issued, before = store.analyses.load(run)[0].calibration, store.count_rows()
        edit(path, statement, run)
        with pytest.raises(StoreError, match=f"run {run}: .* was changed"):
            read(store, run, issued)
        with pytest.raises(StoreError, match=f"run {run}: .* was changed"):
            store.analyses.save(again)
        assert store.count_rows() == before


def test_every_table_of_a_run_is_covered_or_said_not_to_be():
    # An archive's row says only where arrays are that a frame block's digest covers.
    elsewhere = {
        *(
            "sensors",
            "run_links",
            "chart_references",
            "releases",
            "archives",
            "outbox",
            "sync_accepts",
            "sync_refusals",
            "sync_settlements",
            "runs_begun",
        ),
        *("station_checks", "station_check_lines", "station_check_frames"),
    }
    assert set(KEYS) | elsewhere == set(Base.metadata.tables)
    for name in KEYS:  # what holds bytes holds a digest of them too, which is covered
        table = Base.metadata.tables[name]
        if any(isinstance(column.type, LargeBinary) for column in table.columns):
            assert any(column.name.endswith("sha256") for column in list_covered(table)), name


def test_a_column_that_is_added_later_changes_no_digest_of_before():
    older, newer = (
        Table("t", MetaData(), Column("a", Whole, primary_key=True), *more)
        for more in ((), (Column("b", FiniteDouble, nullable=True),))
    )
    assert row_text(older, {"a": 1}) == row_text(newer, {"a": 1, "b": None})
    assert row_text(newer, {"a": 1, "b": 0.1}) == '{"a":1,"b":0.1}'


@pytest.mark.rest
@pytest.mark.postgres
def test_the_chain_is_the_same_on_postgresql(copied, postgres_database):
    """Rows that are copied from SQLite keep their chain."""
    path, run = copied
    with open_store(postgres_database) as target:
        target.count_rows()
    source, central = (
        create_engine(f"sqlite:///{path}"),
        create_engine(postgres_database.replace("postgresql:", "postgresql+psycopg:")),
    )
    with source.connect() as reading, central.begin() as writing:
        writing.exec_driver_sql("SET session_replication_role = replica")
        for table in Base.metadata.sorted_tables:
            rows = [dict(row) for row in reading.execute(table.select()).mappings()]
            if rows and table.name != "sync_accepts":  # a new database has its row
                writing.execute(table.insert(), rows)
    source.dispose()
    central.dispose()
    with open_store(f"sqlite:///{path}") as store:
        here = store.runs.load(run).chain
    with open_store(postgres_database) as store:
        assert store.runs.load(run).chain == here
        assert store.fleet.load_table().runs


# Keys


def test_a_run_whose_chain_was_removed_is_unchained_and_goes_on_so(tmp_path):
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url) as store:
        run = store.new_id()
        journalled(store, short_run(run)[:8])
    edit(tmp_path / "runs.db", "delete from run_links; update runs set chain = null", run)
    with open_store(url) as store:
        assert store.runs.load(run).chain == ChainState()
        assert store.runs.load(run).chain.words.startswith("no chain: ")
        journalled(store, [RunStarted(identity(run)), *short_run(run)[10:12]])
        assert store.runs.load(run).chain == ChainState("unchained", "none", None)


@pytest.mark.parametrize(
    ("begun_with", "read_with", "words"),
    [
        pytest.param(None, None, "chained by digests, not signed", marks=REST),
        (None, KEY, "chained by digests, not signed"),
        (KEY, KEY, "chained by digests and signed"),
        (KEY, OTHER, "signatures not checked"),
        pytest.param(KEY, None, "signatures not checked", marks=REST),
    ],
)
def test_the_state_of_a_chain_is_said(tmp_path, monkeypatch, begun_with, read_with, words):
    url = f"sqlite:///{tmp_path / 'runs.db'}"

    def key(value):
        monkeypatch.delenv(VARIABLE, raising=False) if value is None else monkeypatch.setenv(VARIABLE, value)

    key(begun_with)
    with open_store(url) as store:
        run = store.new_id()
        journalled(store, short_run(run)[:8])
    key(read_with)
    with open_store(url) as store:
        assert words in store.runs.load(run).chain.words
        if begun_with and begun_with != read_with:
            with pytest.raises(StoreError, match=r"is signed with key .* (is set|set here)"):
                store.runs.check_resumable(run)
            with pytest.raises(StoreError, match="is signed with key"):
                journalled(store, [RunStarted(identity(run))])
        elif begun_with == read_with:
            store.runs.check_resumable(run)
    assert KEY not in "".join(sqlite3.connect(tmp_path / "runs.db").iterdump())


def forged(path, run):
    """Change a load and compute every digest again, as one can who has the database and no key."""
    with sqlite3.connect(path) as database:
        database.execute("update loads set x_mm = 15.5 where run = ?", (run,))
        database.row_factory = sqlite3.Row
        row = dict(database.execute("select * from loads where run = ?", (run,)).fetchone())
        row["eased"] = json.loads(row["eased"]) if row["eased"] else None
        ((_, content),) = documents(Base.metadata.tables["loads"], [row])
        before = ""
        for link in database.execute("select * from run_links where run = ? order by number", (run,)).fetchall():
            own = content if link["kind"] == "loads" else link["content_sha256"].hex()
            before = link_digest(before, link["kind"], link["document"], own)
            place = (bytes.fromhex(own), bytes.fromhex(before), run, link["number"])
            database.execute(
                "update run_links set content_sha256 = ?, sha256 = ? where run = ? and number = ?", place
            )


@pytest.mark.parametrize("stored", ["", KEY], indirect=True)
def test_who_has_no_key_cannot_compute_a_signed_chain_again(copied, stored):
    path, run = copied
    forged(path, run)
    with open_store(f"sqlite:///{path}") as store:
        if not stored[1]:
            assert store.runs.load(run).phases[0].loads[0].load.x_mm == 15.5  # what digests alone are worth
            return
        with pytest.raises(StoreError, match=r"link .* loads .* was not signed with key"):
            store.runs.load(run)
    edit(path, "update run_links set mac = null where number > 3", run)
    with open_store(f"sqlite:///{path}") as store, pytest.raises(StoreError, match="is not signed, unlike its run"):
        store.runs.load(run)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("", "has 0 characters"),
        ("short", "has 5 characters"),
        ("   spaces only around 1   "[:10], "characters"),
        ("@no such file", "cannot be read: No such file"),
        ("@short.key", "has 3 characters"),
        ("@binary.key", "cannot be read: not UTF-8 text"),
    ],
)
def test_a_key_that_cannot_be_used_is_refused_and_not_repeated(tmp_path, monkeypatch, setting, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.key").write_text("abc\n")
    (tmp_path / "binary.key").write_bytes(b"\xff" * 32)
    monkeypatch.setenv(VARIABLE, setting)
    with pytest.raises(ConfigError, match=said) as refused:
        open_store(f"sqlite:///{tmp_path / 'runs.db'}")
    assert refused.value.exit_code == 2
    assert not (tmp_path / "runs.db").exists()
    assert setting[:5] not in str(refused.value) or not setting


def test_a_key_from_a_file_is_the_same_key_and_never_shown(tmp_path):
    (tmp_path / "key").write_text(f"{KEY}\n")
    from_file = SigningKey.from_environment({VARIABLE: f"@{tmp_path / 'key'}"})
    assert from_file.key_id == SigningKey.from_environment({VARIABLE: KEY}).key_id
    assert repr(from_file) == f"SigningKey({from_file.key_id})"
    assert SigningKey.from_environment({}) is None


def test_measurements_in_another_order_are_the_same_fleet(tmp_path, monkeypatch):
    """A database may return rows in any order: that is no reason to refuse them, nor to check each run by itself."""
    random, url = np.random.default_rng(1), f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url, durable=False) as store:
        for n in range(3):
            store_run(store, f"S-{n}", judged(measured(random, random.standard_normal(3))), batch="41")
        before = store.fleet.load_table()
    with sqlite3.connect(tmp_path / "runs.db") as database:
        rows = database.execute("select * from measurements order by number desc, analysis").fetchall()
        database.execute("delete from measurements")
        database.executemany(f"insert into measurements values ({','.join('?' * len(rows[0]))})", rows)
    by_itself = []
    monkeypatch.setattr(fleet, "check_run", lambda _, run: by_itself.append(run))
    with open_store(url) as store:
        assert sorted(store.fleet.load_table().value) == sorted(before.value)
    assert by_itself == []


@pytest.mark.parametrize("added_between", [False, True])
def test_a_result_is_added_to_what_was_analysed_or_the_run_is_checked_again(copied, added_between):
    """An analysis takes minutes: only what is added meanwhile makes a second check of all rows necessary."""
    path, run = copied
    with open_store(f"sqlite:///{path}") as store:
        result = RunResult(store.runs.load(run), None, MEASURED, decide(MEASURED), None, "")
        if added_between:
            store.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="so")
        before = len(store.analyses.load(run))
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("UPDATE steps SET time_s = 7e6 WHERE run = ? AND number = 0", (run,))
        if added_between:
            with pytest.raises(StoreError, match=f"run {run}: .* was changed"):
                store.analyses.save(result)
        else:
            store.analyses.save(result)
        assert len(store.analyses.load(run)) == before + (not added_between)
        with pytest.raises(StoreError, match=f"run {run}: .* was changed"):  # whoever reads it next
            store.runs.load(run)


def stripped(path):
    with sqlite3.connect(path) as database:
        database.executescript("delete from run_links; update runs set chain = null")


@pytest.mark.parametrize("chained", [True, pytest.param(False, marks=REST)], ids=["not signed", "no chain"])
def test_a_run_that_no_key_vouches_for_is_not_added_to_where_a_key_is_set(tmp_path, monkeypatch, chained):
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    run = filled(url)
    if not chained:
        stripped(tmp_path / "runs.db")
    monkeypatch.setenv(VARIABLE, KEY)
    said = f"run {run} {'is not signed' if chained else 'has no chain'}, and a signing key is set"
    with open_store(url) as store:
        result, before = (
            RunResult(store.runs.load(run), None, MEASURED, decide(MEASURED), None, ""),
            store.count_rows(),
        )
        for add in (
            lambda: store.runs.check_resumable(run),
            lambda: store.analyses.save(result),
            lambda: store.changes.override_verdict(run, Outcome.PASS, operator="Zoë", why="so"),
        ):
            with pytest.raises(StoreError, match=said) as refused:
                add()
            assert f"unset {VARIABLE}" in refused.value.remedy
        assert store.count_rows() == before


def test_a_run_without_a_chain_warns_of_it(tmp_path):
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    run = filled(url)
    with open_store(url) as store:
        assert store.runs.load(run).chain.warnings == ()
        stripped(tmp_path / "runs.db")
        assert "no chain: it was removed" in store.runs.load(run).chain.warnings[0]
