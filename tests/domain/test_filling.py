"""JSON becomes the types of a dataclass's fields, or is refused."""

from dataclasses import dataclass
from enum import StrEnum

import pytest

from cbsr_qa.domain.filling import fill_from_mapping, fill_from_object


class Word(StrEnum):
    ONE = "one"


@dataclass(frozen=True)
class Place:
    x_mm: float
    y_mm: float = 0.0


@dataclass(frozen=True)
class Ring:
    count: int
    pairs: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Kept:
    word: Word
    at: Place | Ring
    range: tuple[float, float] | None = None


@pytest.mark.parametrize(
    ("values", "kept"),
    [
        ({"word": "one", "at": {"x_mm": 1.0}}, Kept(Word.ONE, Place(1.0))),
        ({"word": "one", "at": {"count": 3, "pairs": [[0, 1]]}, "range": [0, 1], "more": 7},
         Kept(Word.ONE, Ring(3, ((0, 1),)), (0, 1))),
        ({"word": "one", "at": {"count": 3, "pairs": None}, "range": None}, Kept(Word.ONE, Ring(3))),
    ],
)  # fmt: skip
def test_values_become_the_fields_types(values, kept):
    assert fill_from_mapping(Kept, values) == kept
    assert fill_from_object(Kept, kept, range=(0.0, 2.0)) == Kept(kept.word, kept.at, (0.0, 2.0))


@pytest.mark.parametrize(
    "change",
    [
        {"word": "two"},
        {"at": 3},
        {"at": {"z_mm": 1.0}},
        {"at": {"y_mm": 1.0}},
        {"at": {"count": 3, "pairs": [[0, 1, 2]]}},
        {"at": {"count": 3, "pairs": 7}},
        {"range": [1.0]},
        {"range": 7},
    ],
)
def test_values_that_do_not_fit_are_refused(change):
    with pytest.raises((KeyError, TypeError, ValueError)):
        fill_from_mapping(Kept, {"word": "one", "at": {"x_mm": 1.0}} | change)
