"""Tables of presses are refused by file, row and column."""

import re
import sys

import numpy as np
import pytest
from pressed_sheets import adjacent_pairs

from cbsr_qa.calibration.presses.number_tables import read_table
from cbsr_qa.calibration.presses.tables import read_pairs, read_presses
from cbsr_qa.domain.errors import RecordingError


def written(tmp_path, text, name="table.csv"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8-sig")
    return path


def test_labels_are_read_with_their_units(tmp_path):
    table = read_presses(written(tmp_path, "time_s, x_mm,y_mm,who,force_N\n0,1,2,me,3\n\n1.5,-4,5e1,you,7\n"))
    np.testing.assert_array_equal(table.place_mm, [[1, 2], [-4, 50]])
    np.testing.assert_array_equal(table.force_N, [3, 7])
    np.testing.assert_array_equal(table.time_s, [0, 1.5])
    assert table.depth_mm is None


def test_commas_at_the_end_of_every_line_are_no_column(tmp_path):
    table = read_table(written(tmp_path, "a,b,\r\n1,2,\r\n3,4,\r\n,,\r\n\r\n"))
    np.testing.assert_array_equal(table.numbers(), [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "is empty"),
        ("x_mm,y_mm\n", "not one row"),
        ("1.5,2\n3,4\n", "line 1 holds numbers"),
        ("x_mm;y_mm\n1;2\n", "semicolons"),
        ("x_mm\ty_mm\n1\t2\n", "tabs"),
        ("x_mm,y_mm\n1,2\n,\n3,4\n", "row 2, column x_mm: empty"),
        ("x_mm,y_mm\n1_0,2\n", "row 1, column x_mm: '1_0', not a finite number"),
        ("x_mm,y_mm\n1,2,3\n", "row 1: 3 cells, the header has 2 (is a comma a decimal point there?)"),
        ("x_mm,x_mm,y_mm\n1,2,3\n", "'x_mm' more than once"),
        ("x,y_mm\n1,2\n", "column 'x' has no unit: x_mm"),
        ("x_mm,y_m\n1,2\n", "column 'y_m' is in a unit that is not known: y_mm"),
        ("X (mm),y_mm\n1,2\n", "column 'X (mm)' is spelled differently: x_mm"),
        ("x_mm,y_mm,Force_n\n1,2,3\n", "column 'Force_n' is spelled differently: force_N"),
        ("x_mm,z\n1,2\n", "column y_mm is missing"),
        ("x_mm,y_mm,force\n1,2,3\n", "column 'force' has no unit: force_N"),
        ("x_mm,y_mm\n1,2\n3,nan\n", "row 2, column y_mm: 'nan', not a finite number"),
        ("x_mm,y_mm\n1,\n3,4\n", "row 1, column y_mm: empty"),
        ("x_mm,y_mm\n1,1e13\n3,4\n", "row 1, column y_mm: 1e+13; at most 1e+12 is allowed"),
        ("x_mm,y_mm\n1,two\n3,4\n", "row 1, column y_mm: 'two'"),
        ("x_mm,y_mm,depth_mm\n1,2,3\n4,5,3\n", "column depth_mm: all 2 rows hold 3"),
        ("x_mm,y_mm,time_s\n1,2,3\n4,5,3\n", "column time_s: all 2 rows hold 3"),
    ],
)
def test_labels_that_cannot_be_used_are_refused(tmp_path, text, why):
    path = written(tmp_path, text)
    with pytest.raises(RecordingError, match=re.escape(why)) as refused:
        read_presses(path)
    assert str(path) in refused.value.reason


def test_a_file_that_is_no_table_is_refused(tmp_path):
    for path in (tmp_path / "missing.csv", tmp_path):
        with pytest.raises(RecordingError, match="cannot be read"):
            read_table(path)
    (tmp_path / "latin.csv").write_bytes(b"x_mm,y_mm\n\xe9,2\n")
    with pytest.raises(RecordingError, match="not CSV in UTF-8"):
        read_table(tmp_path / "latin.csv")


def test_parquet_says_what_it_needs(tmp_path, monkeypatch):
    for module in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(RecordingError, match="needs pyarrow"):
        read_table(written(tmp_path, "", "presses.parquet"))


def test_pairs_are_read_in_any_order_of_columns(tmp_path):
    pairs = read_pairs(written(tmp_path, "plus,minus,source,sink\n4,3,0,8\n5,4,0,8\n"), 16)
    np.testing.assert_array_equal(pairs, [[0, 8, 4, 3], [0, 8, 5, 4]])


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("0,8,4,16", "row 1, column minus: 16; electrodes are whole numbers from 0 to 15"),
        ("0,-1,4,5", "row 1, column sink: -1"),
        ("0,8.5,4,5", "row 1, column sink: 8.5"),
        ("8,8,4,5", "row 1, column sink: current from electrode 8 to itself"),
        ("0,8,4,4", "row 1, column minus: voltage between electrode 4 and itself"),
        ("0,8,4,", "row 1, column minus: empty"),
    ],
)
def test_pairs_that_are_none_are_refused(tmp_path, row, why):
    with pytest.raises(RecordingError, match=re.escape(why)):
        read_pairs(written(tmp_path, f"source,sink,plus,minus\n{row}\n"), 16)


def test_a_pattern_without_its_columns_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="missing: sink"):
        read_pairs(written(tmp_path, "source,drain,plus,minus\n0,1,2,3\n"), 16)


def test_pairs_at_a_driven_electrode_as_no_others_and_electrodes_from_one_are_refused(tmp_path):
    pairs = [",".join(map(str, pair)) for pair in adjacent_pairs().tolist()]
    pairs[2] = "0,1,0,4"
    text = "\n".join(["source,sink,plus,minus", *pairs])
    with pytest.raises(RecordingError, match="row 3: 0,1,0,4 measures at an electrode that it drives, which 207 of"):
        read_pairs(written(tmp_path, text), 16)
    from_one = [",".join(map(str, pair)) for pair in (adjacent_pairs() + 1).tolist()]
    text = "\n".join(["source,sink,plus,minus", *from_one])
    with pytest.raises(RecordingError, match=r"csv: electrodes are numbered from 1 to 16; they are counted from 0"):
        read_pairs(written(tmp_path, text), 16)
    every = [f"0,8,{plus},{(plus + 1) % 16}" for plus in range(16)]  # a quarter of such a pattern does
    assert len(read_pairs(written(tmp_path, "\n".join(["source,sink,plus,minus", *every])), 16)) == 16


def test_a_pattern_that_measures_at_all_driven_electrodes_is_read_however_many_there_are(tmp_path):
    """Three of the 32 measurements of each drive: less than a tenth of the pairs."""
    every = [f"{d},{(d + 1) % 32},{m},{(m + 1) % 32}" for d in range(32) for m in range(32)]
    assert len(read_pairs(written(tmp_path, "\n".join(["source,sink,plus,minus", *every])), 32)) == 1024
    one_drive = [f"0,32,{m},{(m + 1) % 64}" for m in range(64)]
    assert len(read_pairs(written(tmp_path, "\n".join(["source,sink,plus,minus", *one_drive])), 64)) == 64
    opposite = [f"{d},{d + 8},{m},{m + 1}" for d in range(8) for m in range(15) if not {d, d + 8} & {m, m + 1}]
    opposite[0] = "0,8,0,2"
    with pytest.raises(RecordingError, match="row 1: 0,8,0,2 measures at an electrode that it drives"):
        read_pairs(written(tmp_path, "\n".join(["source,sink,plus,minus", *opposite])), 16)
