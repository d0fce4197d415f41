"""Tables that would fill memory, never end or wait for ever are refused by name."""

import os
import resource

import numpy as np
import pytest

from cbsr_qa.calibration.presses.number_tables import read_table
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.system.untrusted import CONTAINED

pytestmark = pytest.mark.skipif(not CONTAINED, reason="there are no reading children on this platform")


def _wide_csv(path):
    path.write_text(",".join(f"c{k}" for k in range(200_000)) + "\n" + ",".join(["1"] * 200_000) + "\n")


def _one_line(path):
    path.write_text("x_mm,y_mm\n" + "1," * 2_000_000)


def _one_cell(path):
    path.write_text("x_mm,y_mm\n1," + "1" * 1_000_000)


def _sparse(path):
    with path.open("wb") as file:
        file.truncate(2**30)


CSV = [
    (os.mkfifo, "it is a named pipe, not a file"),
    (lambda path: path.symlink_to("/dev/zero"), "it is a device, not a file"),
    (lambda path: path.symlink_to("/dev/urandom"), "it is a device, not a file"),
    (_wide_csv, "has 200000 columns; a table has at most 65536"),
    (_one_line, "has a line of 2097152 characters or more; a table has at most 65536 columns"),
    (_one_cell, "not CSV in UTF-8: field larger than field limit"),
    (_sparse, "it is too large: at most 512 MiB are read"),
]


@pytest.mark.parametrize(("make", "why"), CSV)
def test_csv_that_is_no_table_is_refused(tmp_path, make, why):
    path = tmp_path / "presses.csv"
    make(path)
    with pytest.raises(RecordingError, match=rf"presses\.csv.*{why}"):
        read_table(path)


def _rows(pa):
    return {name: pa.array(np.zeros(4_000_000)) for name in ("x_mm", "y_mm")}


def _columns(pa):
    one = pa.array([1.0])
    return {f"c{k}": one for k in range(66_000)}


def _alike(pa, value, count):
    """A value so many times, which takes the room of one until it is read: here and in the file."""
    return pa.DictionaryArray.from_arrays(np.zeros(count, np.int8), pa.array([value]))


def _texts(pa):
    return {"x_mm": _alike(pa, "a" * 10_000_000, 150), "y_mm": pa.array([0.0] * 150)}


def _lists(pa):
    texts = _alike(pa, "a" * 10_000_000, 150)
    return {"x_mm": pa.ListArray.from_arrays(np.arange(0, 151, 10, np.int32), texts), "y_mm": pa.array([0.0] * 15)}


@pytest.mark.rest
@pytest.mark.parametrize(
    ("columns", "why"),
    [
        (_rows, "of 4000000 rows and 2 columns is too large for a file of"),
        (_columns, "has 66000 columns; a table has at most 65536"),
        (_texts, r"needs more than 1\.\d GiB of memory"),
        (_lists, r"needs more than 1\.\d GiB of memory"),
    ],
)
def test_parquet_that_unpacks_to_more_is_refused(tmp_path, columns, why):
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "presses.parquet"
    # Without the schema of Arrow a reader takes values that are alike for plain ones.
    parquet.write_table(pa.table(columns(pa)), path, compression="zstd", store_schema=False)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingError, match=rf"presses\.parquet.*{why}") as refused:
        read_table(path)
    assert "damaged" not in str(refused.value)  # it is sound, and holds too much
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**16  # KiB


def test_the_table_of_a_large_sensor_is_read_in_both_formats(tmp_path):
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    values = np.random.default_rng(1).normal(size=(40, 1024))
    names = [f"r{k}" for k in range(1024)]
    parquet.write_table(pa.table(dict(zip(names, values.T, strict=True))), tmp_path / "readings.parquet")
    rows = [names, *([repr(value) for value in row] for row in values.tolist())]
    (tmp_path / "readings.csv").write_text("\n".join(map(",".join, rows)))
    for suffix in ("csv", "parquet"):
        table = read_table(tmp_path / f"readings.{suffix}")
        assert table.columns == tuple(names)
        np.testing.assert_array_equal(table.numbers(), values)


def test_every_odd_cell_is_counted_and_the_first_ones_are_named(tmp_path):
    path = tmp_path / "presses.csv"
    path.write_text("x_mm,y_mm\n" + "a,1\n" * 30 + "2,b\n" * 20)
    with pytest.raises(RecordingError, match=r"row 1, column x_mm: 'a'.*row 10, column x_mm: 'a'.*; and 40 more"):
        read_table(path).numbers()
    with pytest.raises(RecordingError, match=r"row 31, column y_mm: 'b'.*; and 10 more"):
        read_table(path).numbers(["y_mm"])
