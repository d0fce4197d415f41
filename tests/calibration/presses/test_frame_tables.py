"""Tables of frames: times, units, complex readings, and everything that is wrong with them, by row and column."""

import re

import numpy as np
import pytest

from cbsr_qa.calibration.presses.frame_tables import (
    ComplexPart,
    check_same_unit,
    read_complex_tables,
    read_frame_table,
    real_readings,
)
from cbsr_qa.calibration.presses.tables import read_pairs
from cbsr_qa.domain.errors import RecordingError

ROWS = "time_s,a,b,c\n0,1.0,2.0,-3.0\n0.5,1.1,2.1,-3.1\n1.0,1.2,2.2,-3.2\n"


def written(folder, text, name="frames.csv", encoding="utf-8"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_times_stand_in_their_own_column_anywhere(tmp_path, encoding):
    table = read_frame_table(written(tmp_path, ROWS, encoding=encoding), 3)
    np.testing.assert_array_equal(table.time_s, [0, 0.5, 1.0])
    np.testing.assert_array_equal(table.readings[1], [1.1, 2.1, -3.1])
    assert read_frame_table(written(tmp_path, "a,time_s\n1,0\n2,3\n"), 1).columns == ("a",)
    assert read_frame_table(written(tmp_path, "a,b\n1,0\n"), 2).time_s is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (ROWS.replace("1.0,1.2,2.2,-3.2", "0.4,1.2,2.2,-3.2"), "row 3, column time_s: 0.4 after 0.5; times rise"),
        (ROWS.replace("1.0,1.2,2.2,-3.2", "0.5,1.2,2.2,-3.2"), "row 3, column time_s: 0.5 after 0.5; times rise"),
        (ROWS.replace("time_s", "time_ms"), "column 'time_ms': time_s is allowed"),
        (ROWS.replace("time_s", "Time [s]"), "column 'Time [s]': time_s is allowed"),
        (ROWS.replace("time_s", "more"), "has 4 columns, the pattern has 3 rows; the first is 'more', the last 'c'"),
        (ROWS.replace(",2.1,", ","), "row 2: 3 cells, the header has 4"),
        (ROWS.replace("2.1", "2,1"), "row 2: 5 cells, the header has 4 (is a comma a decimal point there?)"),
        (ROWS.replace("2.1", "two"), "row 2, column b: 'two', not a finite number"),
        (ROWS.replace("2.1", "NaN"), "row 2, column b: 'NaN', not a finite number"),
        (ROWS.replace("2.1", ""), "row 2, column b: empty"),
        (ROWS.replace("2.1", "2+1j"), "row 2, column b: 2+1j, a complex number"),
        (ROWS.replace(",", ";").replace(".", ","), "line 1: separated by semicolons"),
        ("", "is empty"),
        (ROWS.partition("\n")[0], "only a header, not one row"),
    ],
)
def test_mistakes_are_named_by_row_and_column(tmp_path, text, why):
    with pytest.raises(RecordingError, match=re.escape(why)) as refused:
        read_frame_table(written(tmp_path, text), 3)
    assert "frames.csv" in refused.value.reason


def test_a_table_in_another_encoding_is_named(tmp_path):
    with pytest.raises(RecordingError, match="not CSV in UTF-8") as refused:
        read_frame_table(written(tmp_path, ROWS, encoding="utf-16"), 3)
    assert refused.value.remedy


def test_rows_columns_and_tables_in_another_unit_are_named(tmp_path):
    def scaled(name, **factors):
        rows = [[1.0, 2.0, -3.0], [1.1, 2.1, -3.1], [1.2, 2.2, -3.2]]
        factor = np.array([factors.get(column, 1.0) for column in "abc"])
        lines = [",".join(map(str, factor * row)) for row in rows]
        return read_frame_table(written(tmp_path, "\n".join(["a,b,c", *lines]), name), 3)

    rest = scaled("rest.csv")
    check_same_unit(rest, rest)
    row = read_frame_table(written(tmp_path, ROWS.replace("1.1,2.1,-3.1", "1100,2100,-3100")), 3)
    with pytest.raises(RecordingError, match=r"frames.csv: row 2: its readings are \d{3}\.?\d* times as large"):
        check_same_unit(row)
    with pytest.raises(RecordingError, match=r"its readings are 1000 times as large as those of .*rest.csv"):
        check_same_unit(scaled("frames.csv", a=1e3, b=1e3, c=1e3), rest)
    with pytest.raises(RecordingError, match=r"column b: its readings are 0.001 times as large as those of"):
        check_same_unit(scaled("frames.csv", b=1e-3), rest)
    many = "\n".join(["a,b,c", *(f"1.{k},2.{k},-3.{k}" for k in range(9))])
    wrong = read_frame_table(written(tmp_path, many.replace("2.4", "2400"), "rest.csv"), 3)
    with pytest.raises(RecordingError, match=r"rest.csv: row 5, column b: 960 times as large as in the other rows"):
        check_same_unit(rest, wrong)


def test_each_part_of_complex_readings_is_what_its_name_says(tmp_path):
    unloaded = np.array([2 * np.exp(0.3j), -3 * np.exp(0.4j), 1.0 + 0j])
    rows = np.array([[1.1, 1.0, 0.9], [1.0, 0.8, 1.2]]) * unloaded
    np.testing.assert_allclose(real_readings(rows, unloaded, ComplexPart.REAL), rows.real)
    np.testing.assert_allclose(real_readings(rows, unloaded, ComplexPart.MAGNITUDE), np.abs(rows))
    np.testing.assert_allclose(
        real_readings(rows, unloaded, ComplexPart.IN_PHASE), [[2.2, -3.0, 0.9], [2.0, -2.4, 1.2]]
    )
    quadrature = rows + 0.1j * unloaded  # what is a quarter of a turn away is no change in phase
    np.testing.assert_allclose(
        real_readings(quadrature, unloaded, ComplexPart.IN_PHASE), real_readings(rows, unloaded, ComplexPart.IN_PHASE)
    )
    text = "a,b\n1+2j,(3-4j)\n5,6i\n"
    (table,) = read_complex_tables(written(tmp_path, text), None, 2, ComplexPart.MAGNITUDE)
    np.testing.assert_allclose(table.readings, [[np.sqrt(5), 5], [5, 6]])


def test_real_numbers_have_no_complex_part(tmp_path):
    with pytest.raises(RecordingError, match="no complex number in it"):
        read_complex_tables(written(tmp_path, ROWS), None, 3, ComplexPart.REAL)


def test_a_pair_that_stands_twice_is_named_unless_pairs_do(tmp_path):
    pairs = [f"0,1,{k},{k + 1}" for k in range(2, 14)]
    pairs[8] = pairs[3]
    with pytest.raises(RecordingError, match="row 9 repeats row 4: 0,1,5,6"):
        read_pairs(written(tmp_path, "\n".join(["source,sink,plus,minus", *pairs])), 16)
    repeated = "\n".join(["source,sink,plus,minus", *pairs[:8], *pairs[:8]])
    assert len(read_pairs(written(tmp_path, repeated), 16)) == 16


def test_a_pattern_of_more_electrodes_is_named_once(tmp_path):
    pairs = [f"{k},{(k + 1) % 16},{(k + 3) % 16},{(k + 4) % 16}" for k in range(16)]
    with pytest.raises(RecordingError, match="it has 16 electrodes, up to 15; the sensor type has 8, counted from 0"):
        read_pairs(written(tmp_path, "\n".join(["source,sink,plus,minus", *pairs])), 8)
