"""Dataclasses as entries and back: what names and types say, what is declared, and files of before a field was."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pytest
from calibration_samples import assert_same, sample_calibration, sparse_calibration

from cbsr_qa.calibration.file.content import Reading
from cbsr_qa.calibration.file.entries import decode, encode
from cbsr_qa.calibration.file.fields import Codec, Entries, problems
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.kept import COLUMNS, Kept, walk_fields
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import Calibration


@dataclass(frozen=True)
class Place:
    label: str
    x_mm: float
    loads: int
    tilt_deg: Annotated[float, Kept(since=3)] = 0.0


@dataclass(frozen=True)
class Sheet:
    name: str
    thickness_mm: float
    places: Annotated[tuple[Place, ...], Kept("places/")]
    age_s: float | None = None
    humidity: Annotated[float | None, Kept("air/humidity", "%", since=2)] = None


CODEC = Codec({})
SHEET = Sheet("a", 2.5, (Place("L0", -0.0, 3), Place("L1", 7.0, 1)))


def written(value):
    entries: Entries = {}
    CODEC.write(entries, value, "sheet/")
    return entries


def test_name_and_type_say_path_units_and_kind():
    entries = written(SHEET)
    assert {path: entry.units for path, entry in entries.items()} == {
        "sheet/name": "text",
        "sheet/thickness": "mm",
        "sheet/places/label": "text",
        "sheet/places/x": "mm",
        "sheet/places/loads": "1",
        "sheet/age": "s",
    }
    assert entries["sheet/places/loads"].value.dtype == np.int64
    assert np.isnan(entries["sheet/age"].value)
    assert not np.signbit(entries["sheet/places/x"].value).any()


@pytest.mark.parametrize(
    "sheet",
    [
        Sheet("a", 2.5, (Place("L0", 0.5, 3), Place("L1", 7.0, 1))),
        Sheet("b", 1.0, (), 4.0, 55.0),
        Sheet("c", 1.0, (Place("L0", 1.0, 2, 0.0), Place("L1", 1.0, 2, 4.5))),
    ],
)
def test_what_is_written_comes_back(sheet):
    assert_same(CODEC.read(Reading(written(sheet)), Sheet, "sheet/"), sheet, "sheet")


def test_a_field_of_a_later_version_is_written_only_where_it_says_something():
    assert not {"sheet/air/humidity", "sheet/places/tilt"} & written(SHEET).keys()
    later = written(Sheet("b", 1.0, (Place("L0", 1.0, 2, 4.5),), None, 55.0))
    assert (later["sheet/air/humidity"].units, later["sheet/places/tilt"].units) == ("%", "deg")


def test_a_field_without_a_default_is_missed_by_its_path():
    entries = written(SHEET)
    del entries["sheet/thickness"]
    with pytest.raises(CalibrationError, match="sheet/thickness is missing"):
        CODEC.read(Reading(entries), Sheet, "sheet/")


@dataclass(frozen=True)
class Table:
    rows: Annotated[int, Kept(least=2, most=9)]
    values: Annotated[Array, Kept(dims="n 2", most=10.0)]
    pairs: Annotated[Array, Kept(dims="2n", least=0)]


@pytest.mark.parametrize(
    ("rows", "values", "pairs", "said"),
    [
        (2, [[1, 2]], [0, 1], None),
        (1, [[1, 2]], [0, 1], "t/rows is 1; 2 to 9 are allowed"),
        (2, [[1, 11]], [0, 1], "t/values holds 11; 10 is allowed"),
        (2, [[1, np.nan]], [0, 1], "t/values holds a value that is not a finite number"),
        (2, [[1, 2, 3]], [0, 1], "t/values of (1, 3) does not fit 2 columns"),
        (2, [1, 2], [0, 1], "t/values has the shape (2,); (n, 2) is expected"),
        (2, [[1, 2]], [0, 1, 2], "t/pairs of (3,) does not fit 2 n"),
        (2, [[1, 2]], [0, -1], "t/pairs is negative somewhere"),
    ],
)
def test_limits_and_axes_are_held(rows, values, pairs, said):
    table = Table(rows, np.array(values, dtype=float), np.array(pairs, dtype=float))
    assert next(problems(table, "t/"), None) == said


@pytest.mark.parametrize("make", [sample_calibration, sparse_calibration])
def test_every_path_of_the_table_is_in_a_file_and_no_other(make):
    calibration = make()
    held = set(encode(calibration))
    groups = {path for path, _ in walk_fields(Calibration) if path.endswith("/")}
    leaves = {path + COLUMNS * field.kept.columns for path, field in walk_fields(Calibration)} - groups
    irregular = ("relaxation/", "mesh/", "sensor_type/electrodes", "sensor_type/mesh/", "force/none")
    assert not {path for path in held if not path.startswith((*irregular, *groups)) and path not in leaves}
    optional = {
        "indenter/outline",
        *(f"validity/response_per_C{end}" for end in ("", "_stderr", "_source")),
        *(path for path in leaves if path.startswith(("sensor_type/", "mesh/", "force/", "place/"))),
    }
    assert leaves - optional <= held
    assert_same(decode(encode(calibration)), calibration, "calibration")
