"""Tests of the words for a place on a sheet."""

import pytest

from cbsr_qa.domain.results.findings import ImagedPlace


@pytest.mark.parametrize(
    ("electrode", "said"),
    [(15.97, "electrode 0.0"), (15.94, "electrode 15.9"), (0.04, "electrode 0.0"), (7.2, "electrode 7.2")],
)
def test_a_place_is_named_by_an_electrode_that_exists(electrode, said):
    seen = ImagedPlace(0.55, 0.0, electrode, 16, largest=0.1, area_share=0.05)
    assert seen.place == f"{said}, r/R 0.55"


def test_a_place_near_the_centre_has_no_electrode():
    assert ImagedPlace(0.07, 0.0, 3.0, 16, largest=0.1, area_share=0.05).place == "centre (r/R 0.07)"
