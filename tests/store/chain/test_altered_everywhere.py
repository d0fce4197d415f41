"""Whatever shows what is stored of a run refuses it, or marks it, once it does not match its chain."""

import shutil

import pytest
from altered_runs import another_value, change, fill, linked_again
from tiers import REST, rest_but_named

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.states import ResultState
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity
from cbsr_qa.store.chain.links import VARIABLE
from cbsr_qa.store.chain.run_documents import KEYS, list_covered
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs.outcomes import latest_result
from cbsr_qa.store.tables.runs import Base

KEY = "a key of twenty-two let"
SENSOR = SensorIdentity("S-1", "B7", "disc-100mm")
VERDICT = {"runs", "run_states", "analyses", "verdict_overrides"}
JUDGED = VERDICT | {"measurements"}
ANALYSIS = {"analyses", "measurements", "warnings", "calibrations", "calibration_baselines"}
RECORDS = {"configuration_changes", "verdict_overrides", "adoptions", "reanalyses"}
#: Columns of measurements that a comparison reads.
FIGURES = {"analysis", "name", "value", "phase", "qualifier", "unit", "location", "outcome", "bound"}
FIGURES |= {"lower_limit", "upper_limit"}


def marked(runs):
    """Each run that is shown, and what it is marked with."""
    return [(one.run, one.altered) for one in runs if one is not None]


def refusing(read):
    """A reader that shows one run, or refuses."""
    return lambda store, run: [(run, "")] if read(store, run) is not None else []


def measured(store, run):
    found = store.lists.read_measurements([run])
    return [*dict.fromkeys((run, "") for run in found.runs), *found.altered.items()]


#: What shows something of runs: the tables that it shows, and what returns runs with their marks, or refuses.
READERS = {
    "load_run": (set(KEYS), refusing(lambda store, run: store.runs.load(run))),
    "analyses": (ANALYSIS, refusing(lambda store, run: store.analyses.load(run))),
    "lists": (JUDGED, lambda store, run: marked(store.lists.read_runs())),
    "run lines": (VERDICT, lambda store, run: marked(store.fleet.read_lines())),
    "runs of a sensor": (VERDICT, lambda store, run: marked(store.runs.find("S-1"))),
    "comparison, charts, gauge": (JUDGED, refusing(lambda store, run: store.fleet.load_table())),
    "table of measurements": (JUDGED, measured),
    "judged measurements": (
        JUDGED,
        refusing(lambda store, run: store.lists.read_limited_measurements([run]) or None),
    ),
    "page of a station": (VERDICT, lambda store, run: marked([store.live.find_latest("bench-α")])),
    "page of a run": (VERDICT, lambda store, run: marked([store.live.find_run(run)])),
    "history of a sensor": (
        VERDICT,
        lambda store, run: [(one.run, one.changed) for one in store.sensors.read_history(SENSOR, "short").earlier],
    ),
    "overrides": ({"verdict_overrides"}, refusing(lambda store, run: store.changes.list_overrides(run))),
    "changes": (RECORDS, lambda store, run: [(run, store.changes.find_altered().get(run, ""))]),
    "re-analysis": (
        {"reanalyses"},
        refusing(lambda store, run: [store.reanalyses.load(one) for one in store.reanalyses.list_names(run)] or None),
    ),
    "certificate": (
        {"certificates", "certificate_withdrawals", "analyses"},
        refusing(lambda store, run: store.certificates.load("LAB-1")),
    ),
    "file of a calibration": (
        {"calibrations"},
        refusing(
            lambda store, run: (
                [store.calibrations.load_file(one.calibration) for one in store.calibrations.list_issued("S-1")]
                or None
            )
        ),
    ),
}


@pytest.fixture(scope="module", params=["", pytest.param(KEY, marks=REST)], ids=["not signed", "signed"])
def stored(request, tmp_path_factory):
    file = tmp_path_factory.mktemp("altered") / "runs.db"
    with pytest.MonkeyPatch.context() as patch:
        if request.param:
            patch.setenv(VARIABLE, request.param)
        run = fill(f"sqlite:///{file}")
    return file, run, request.param


@pytest.fixture
def copied(stored, tmp_path, monkeypatch):
    """A copy to alter, the run in it, and its key, which is set."""
    file, run, key = stored
    shutil.copy(file, tmp_path / "runs.db")
    if key:
        monkeypatch.setenv(VARIABLE, key)
    return tmp_path / "runs.db", run, key


def believing(path, run, table, column=""):
    """Name the readers that show a table, and show the run as if it was sound."""
    with open_store(f"sqlite:///{path}") as store:
        shown = {name: read for name, (tables, read) in READERS.items() if table in tables}
        if table == "measurements" and column and column not in FIGURES:
            del shown["comparison, charts, gauge"]
        return [name for name, read in shown.items() if (run, "") in runs_shown(read, store, run)]


def runs_shown(read, store, run):
    try:
        return read(store, run)
    except StoreError:
        return []


def test_every_reader_shows_a_sound_run(copied):
    path, run, _ = copied
    with open_store(f"sqlite:///{path}") as store:
        assert [name for name, (_, read) in READERS.items() if (run, "") not in read(store, run)] == []
        (listed,) = (one for one in store.lists.read_runs() if one.run == run)
        assert (listed.verdict, listed.outcome) == (Outcome.PASS, Outcome.FAIL)


QUICK = {("analyses", "outcome"), ("verdict_overrides", "outcome"), ("runs", "serial"), ("measurements", "outcome")}
CELLS = [
    pytest.param(table, column, id=f"{table}.{column.name}", marks=[] if (table, column.name) in QUICK else [REST])
    for table in sorted(KEYS)
    for column in list_covered(Base.metadata.tables[table])
]


@pytest.mark.parametrize(("table", "column"), CELLS)
def test_a_run_with_a_cell_that_was_changed_is_believed_by_nobody(copied, table, column):
    path, run, _ = copied
    change(path, f"update {table} set {column.name} = {another_value(column)}")
    assert believing(path, run, table, column.name) == []


ROWS = {
    "an override without a link": (
        "verdict_overrides",
        "insert into verdict_overrides select 'zzz', run, analysis, 'fail', operator, why, noted_at"
        " from verdict_overrides",
    ),
    "an analysis without a link": (
        "analyses",
        "insert into analyses select 'zzz', run, analysed_at, software, 'pass', reason, calibration_why,"
        " noise_weighting, weight_ratio, compute_s from analyses where outcome = 'fail'",
    ),
    "a state without a link": (
        "run_states",
        "insert into run_states select run, 77, 'finished', '', 1.0, '[]', null, null, null"
        " from run_states where number = 0",
    ),
    "no override": ("verdict_overrides", "delete from verdict_overrides"),
    "no latest analysis": ("analyses", "delete from analyses where outcome = 'fail'"),
    "no last state": ("run_states", "delete from run_states where number = 1"),
    "no link of an override": ("verdict_overrides", "delete from run_links where kind = 'verdict_overrides'"),
    "no link of an analysis": ("analyses", "delete from run_links where kind = 'analyses'"),
    "no link but of frames": ("runs", "delete from run_links where kind not in ('frame_blocks', 'steps')"),
    "no chain": ("runs", "update runs set chain = null"),
    "no change of a file": ("configuration_changes", "delete from configuration_changes"),
}


@pytest.mark.parametrize(
    ("table", "statement"),
    rest_but_named(ROWS, "an override without a link", "no latest analysis", "no link of an analysis", "no chain"),
)
def test_a_run_with_a_row_more_or_less_is_believed_by_nobody(copied, table, statement):
    path, run, _ = copied
    change(path, statement)
    assert believing(path, run, table) == []


def test_a_latest_analysis_that_was_removed_with_its_links_leaves_a_gap(copied):
    """An override follows it: the older verdict does not come back."""
    path, run, _ = copied
    with open_store(f"sqlite:///{path}") as store:
        analysis = store.analyses.load(run)[0].analysis
    for table in ("calibration_baselines", "calibrations"):
        change(path, f"delete from {table}")
    for table in ("measurements", "warnings", "analyses"):
        change(path, f"delete from {table} where analysis = ?", analysis)
    change(path, "delete from run_links where document = ? or kind like 'calibration%'", analysis)
    assert believing(path, run, "analyses") == []


def test_an_override_that_was_removed_with_its_link_leaves_a_gap(copied):
    path, run, _ = copied
    with open_store(f"sqlite:///{path}") as store:
        store.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="seen again")
    change(path, "delete from verdict_overrides where operator = 'Zoë'")
    change(
        path,
        "delete from run_links where kind = 'verdict_overrides' and number ="
        " (select min(number) from run_links where kind = 'verdict_overrides')",
    )
    assert believing(path, run, "verdict_overrides") == []


FORGED = (
    *("analyses.outcome", "verdict_overrides.outcome", "run_states.end", "runs.serial", "measurements.outcome"),
    *("configuration_changes.why", "adoptions.operator", "reanalyses.outcome"),
    *("attendance.text", "gate_answers.outcome", "loads.x_mm"),
)


#: Signed or not: only there the key decides.
@pytest.mark.parametrize(
    ("cell", "stored"),
    [
        pytest.param(cell, key, id=f"{cell}-{way}", marks=() if cell == "analyses.outcome" else REST)
        for cell in FORGED
        for way, key in {"not signed": "", "signed": KEY}.items()
    ],
    indirect=["stored"],
)
def test_links_that_were_computed_again_without_the_key_are_believed_by_nobody(copied, cell):
    path, run, key = copied
    table, _, name = cell.partition(".")
    change(path, f"update {table} set {name} = {another_value(Base.metadata.tables[table].c[name])}")
    linked_again(path, run)
    if key:
        assert believing(path, run, table) == []
    else:  # what digests alone are worth
        with open_store(f"sqlite:///{path}") as store:
            assert ("load_run" in believing(path, run, table)) or store.live.find_run(run) is not None


def test_the_verdict_that_the_parent_process_reads_back_is_checked(copied):
    path, run, _ = copied
    url = f"sqlite:///{path}"
    assert latest_result(url, run) == (ResultState.STORED, Outcome.FAIL)
    change(path, "update analyses set outcome = 'pass'")
    with pytest.raises(StoreError, match=f"run {run}: analyses .* was changed"):
        latest_result(url, run)


def test_changes_of_files_are_shown_without_those_of_an_altered_run(copied):
    path, run, _ = copied
    with open_store(f"sqlite:///{path}") as store:
        record = store.runs.load(run)
        assert len(store.changes.read_history(record).changes) == 1
        change(path, "update configuration_changes set why = 'nobody asked'")
        history = store.changes.read_history(record)
    assert history.changes == ()
    assert f"run {run}: configuration_changes was changed" in history.warnings[0]


def test_a_recipe_counts_as_accepted_only_by_a_run_that_is_sound(copied):
    path, run, _ = copied
    with open_store(f"sqlite:///{path}") as store:
        record = store.runs.load(run)
        (first,) = {one.run for one in store.runs.find()} - {run}
        assert store.changes.read_history(record).accepted_run == first
        change(path, "update analyses set reason = 'all is well' where run = ?", first)
        assert store.changes.read_history(record).accepted_run == ""


@pytest.mark.parametrize("kinds", ["'runs', 'run_states', 'analyses', 'verdict_overrides', 'measurements'", "'runs'"])
def test_a_run_whose_chain_was_removed_but_not_all_its_links_is_altered(copied, kinds):
    path, run, _ = copied
    change(path, "update runs set chain = NULL")
    change(path, "update analyses set outcome = 'pass'")
    change(path, f"delete from run_links where kind in ({kinds})")
    with open_store(f"sqlite:///{path}") as store:
        (listed,) = [one for one in store.lists.read_runs() if one.run == run]
    assert "states no chain, and run_links holds links" in listed.altered
