"""Tables of runs and measurements: the selected ones, whole or not at all, safe in a spreadsheet."""

import csv
import errno
import sys
from datetime import UTC, datetime

import pytest
from exported_runs import five_runs

from cbsr_qa.app.export import export
from cbsr_qa.app.export.export import ExportRequest, export_data
from cbsr_qa.app.shift.lists import ListRequest
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.listed import RunLists


@pytest.fixture(scope="module")
def five():
    return five_runs()


@pytest.fixture
def exported(five, tmp_path, monkeypatch):
    """Return a function that exports, two runs at a time, and returns the outcome's result."""
    monkeypatch.setattr(export, "AT_ONCE", 2)

    def exported(name, tell=lambda words: None, **options):
        return export_data(ExportRequest(tmp_path / name, **options), database=five[0], tell=tell).result

    return exported


def selected(*, failed=False, limit="", latest=None, **selection):
    return ListRequest(RunSelection(checks=False, **selection), failed=failed, limit=limit, latest=latest)


def lines(path):
    return list(csv.DictReader(path.read_text().splitlines()))


def test_a_row_a_run(exported, five):
    told = []
    result = exported("runs.csv", told.append)
    assert (result.format, result.table, result.runs, result.rows) == ("csv", "runs", 5, 5)
    assert result.size_bytes == result.file.stat().st_size
    assert told == ["2 of 5 runs", "4 of 5 runs", "5 of 5 runs"]
    rows = lines(result.file)
    assert [row["run"] for row in rows] == list(five[1].values())
    assert [row["verdict"] for row in rows] == ["marginal", "fail", "not measured", "pass", ""]
    assert [row["outcome"] for row in rows][3:] == ["fail", ""]
    assert rows[0]["started_at"] == "2026-11-21T08:00:00.123456+00:00"
    assert (rows[3]["overridden_by"], rows[4]["end"], rows[0]["simulated"]) == ("Ada", "aborted", "true")


def test_a_row_a_measurement_with_its_unit(exported):
    rows = lines(exported("values.csv", table="measurements").file)
    assert len(rows) == 4 * 3
    error, drift, nothing = rows[:3]
    assert (error["name"], error["value"], error["unit"], error["upper_limit"]) == (
        *("centre_of_mass_error", "5.5", "mm", "6.5"),
    )
    assert (error["serial"], error["phase"], error["location"], error["strain"]) == (
        *("S-0", "nine locations", "L0", "0.2"),
    )
    assert (drift["value"], drift["lower_limit"]) == ("-0.25", "-0.5")
    assert (nothing["value"], nothing["outcome"]) == ("", "not judged")


def test_text_that_is_a_formula_is_escaped_and_numbers_are_not(exported):
    values = exported("values.csv", table="measurements").file.read_text()
    assert ""","'=HYPERLINK(""x"")"\n""" in values
    assert ",-0.25,%/min," in values
    assert lines(exported("runs.csv").file)[4]["operator"] == "'@SUM(1)"


@pytest.mark.parametrize("table", ["runs", "measurements"])
def test_parquet_holds_what_csv_does_with_types(exported, table):
    parquet = pytest.importorskip("pyarrow.parquet")
    read = parquet.read_table(exported("t.parquet", table=table).file)
    rows = lines(exported("t.csv", table=table).file)
    assert read.column_names == list(rows[0])
    kept = read.to_pylist()
    for row, line in zip(kept, rows, strict=True):
        assert row["started_at"] == datetime(2026, 11, 21, 8, 0, 0, 123456, tzinfo=UTC)
        for name, value in row.items():
            if isinstance(value, float):
                assert float(line[name]) == value
            elif isinstance(value, str):
                assert line[name].removeprefix("'") == value
            elif value is None:
                assert line[name] == ""
    if table == "runs":
        assert kept[1]["failed_limits"] == ["centre_of_mass_error (nine locations)"]
        assert kept[1]["of_check"] is False
    else:
        assert read.schema.field("value").type == "double"


@pytest.mark.parametrize(
    ("options", "names"),
    [
        (selected(), ["passed", "failed", "unmeasured", "overridden", "aborted"]),
        (selected(failed=True), ["failed"]),
        (selected(limit="centre_of_mass_error", latest=1), ["failed"]),
        (selected(latest=3), ["unmeasured", "overridden", "aborted"]),
        (selected(stations=("bench-β",)), ["aborted"]),
        (selected(recipe="short", latest=1), ["overridden"]),
    ],
)
def test_the_options_of_runs_select(exported, five, options, names):
    rows = lines(exported("runs.csv", runs=options).file)
    assert [row["run"] for row in rows] == [five[1][name] for name in names]


def test_one_run_by_its_identifier_or_its_sensor(exported, five):
    failed = five[1]["failed"]
    for given in (failed, "S-1"):
        result = exported("one.csv", run=given, force=True)
        assert (result.run, [row["run"] for row in lines(result.file)]) == (failed, [failed])


REFUSED = {
    "no run is selected": {"name": "x.csv", "runs": selected(recipe="long", failed=True)},
    "no stored run is of batch '43'": {"name": "x.csv", "runs": selected(batch="43")},
    "there is no run and no sensor 'S-9'": {"name": "x.csv", "run": "S-9"},
    "unknown suffix '.xlsx'": {"name": "x.xlsx"},
    "no suffix": {"name": "x"},
    "there is no folder": {"name": "absent/x.csv"},
    "is a folder": {"name": ".", "format": "csv"},
    "--format 'cvs' is not known": {"name": "x.csv", "format": "cvs"},
    "--table 'run' is not known": {"name": "x.csv", "table": "run"},
    "--table with junit": {"name": "x.xml", "table": "runs"},
    "--phase with csv": {"name": "x.csv", "phase": "relaxation"},
    "netcdf holds the frames of one run": {"name": "x.nc"},
    "a RUN, and options that select runs": {"name": "x.csv", "run": "S-1", "runs": selected()},
}


@pytest.mark.parametrize("reason", REFUSED)
def test_what_cannot_be_exported_is_refused_and_nothing_is_written(exported, tmp_path, reason):
    with pytest.raises((RefusedError, StoreError), match=reason) as refused:
        exported(**REFUSED[reason])
    assert refused.value.remedy
    assert list(tmp_path.iterdir()) == []


def test_the_nearest_format_is_named(exported):
    with pytest.raises(RefusedError) as refused:
        exported("x.csv", format="parqet")
    assert refused.value.remedy.startswith("did you mean 'parquet'?")


def test_parquet_without_its_library_is_refused(exported, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(RefusedError, match="needs pyarrow") as refused:
        exported("x.parquet")
    assert "cbsr-qa[parquet]" in refused.value.remedy
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_replaced_only_on_demand_and_only_by_a_whole_one(exported, five, tmp_path, monkeypatch):
    file = tmp_path / "runs.csv"
    file.write_text("mine")
    with pytest.raises(RefusedError, match="exists already"):
        exported("runs.csv")
    read = RunLists.read_named

    def full(lists, runs):
        if runs[-1] != five[1]["failed"]:  # on the second page
            raise OSError(errno.ENOSPC, "No space left on device")
        return read(lists, runs)

    with monkeypatch.context() as patched:
        patched.setattr(RunLists, "read_named", full)
        with pytest.raises(RefusedError, match=r"runs\.csv cannot be written: No space"):
            exported("runs.csv", force=True)
    assert file.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [file]
    exported("runs.csv", force=True)
    assert len(lines(file)) == 5
