"""Qualifiers of measurements: what they say is typed, their text stays as it is stored and matched by limits."""

import pytest

from cbsr_qa.domain.results.dimensions import Dimensions
from cbsr_qa.domain.results.measurement import Measurement

QUALIFIERS = {
    "": Dimensions(),
    "worst": Dimensions("worst"),
    "mask 25 %": Dimensions(mask=0.25),
    "mask 62.5 %, reference unloaded run": Dimensions(mask=0.625, reference="unloaded run"),
    "conductance, loading": Dimensions("conductance", "loading"),
    "image against conductance, unloading": Dimensions("image against conductance", "unloading"),
    "conductance, loading, 10 % strain": Dimensions("conductance", "loading", strain=0.1),
    "at the centre, target of 7.82 mm": Dimensions("at the centre", target_mm=7.82),
    "pair 15-0": Dimensions(pair=(15, 0)),
    "drive 3, measure 12": Dimensions(drive=3, measure=12),
    "place known, trial left out": Dimensions("place known, trial left out"),
}


@pytest.mark.parametrize("text", QUALIFIERS)
def test_a_qualifier_and_its_dimensions_stand_for_each_other(text):
    dimensions = QUALIFIERS[text]
    assert Measurement("m", 1.0, "1", qualifier=text).dimensions == dimensions
    assert dimensions.text == text


@pytest.mark.parametrize("text", ["mask half", "mask 1..2 %", "pair 1", "drive -1", "measure ٣ ", "target of nan mm"])
def test_words_that_only_look_like_a_dimension_stay_words(text):
    assert Dimensions.from_qualifier(text) == Dimensions(text)


def test_a_dimension_given_twice_keeps_the_first():
    assert Dimensions.from_qualifier("pair 1-2, pair 3-4") == Dimensions("pair 3-4", pair=(1, 2))
