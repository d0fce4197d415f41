"""The tank data through other reconstructions: where the images show what is known to be there."""

import pytest

from cbsr_qa.app.analyse.analyse import analyse_file
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.report.document import json_document

pytestmark = [pytest.mark.shared, pytest.mark.rest]


def analysed(shared, name, dataset):
    path = shared / "data" / "tank" / "phantom_16elec_1planeB.mat"
    return analyse_file(path, AnalyseRequest(report=False, dataset=dataset, reconstruction=name))


@pytest.mark.parametrize("name", ["gauss-newton-laplace", "greit", "total-variation", "absolute-gauss-newton"])
def test_both_balls_of_phantom_b_are_apart_in_the_image(shared, name):
    """7 cm from the centre of some 13.5 cm, at electrodes 0 and 4; images pull outwards in a tank."""
    events = json_document(analysed(shared, name, "vvAvg3"))["events"]
    for event, electrode in zip(sorted(events, key=lambda e: (e["electrode"] + 2) % 16), (0, 4), strict=True):
        assert event["fate"] == "apart"
        assert abs((event["image"]["electrode"] - electrode + 8) % 16 - 8) <= 0.3
        assert 0.48 <= event["image"]["r_over_R"] <= 0.67


def test_total_variation_says_that_a_tank_settles_no_alpha(shared):
    """No sheet explains a tank to its noise: α is that of a simulated target, and the reader is told."""
    document = json_document(analysed(shared, "total-variation", "vvAvg2"))
    assert any("from this recording" in warning for warning in document["warnings"])
    assert "simulated" in document["reconstruction"]["parameter"]["reason"]


def test_a_press_no_sheet_explains_is_refused_by_an_absolute_method(shared):
    """The strongest press of the lab's board makes a linear image of −280 %: no conductance does that."""
    path = shared / "data" / "black_sensor" / "expABCX_150mm_8.5wt_6.csv"
    request = AnalyseRequest(report=False, reconstruction="absolute-gauss-newton")
    refused = analyse_file(path, request).refused
    assert refused is not None
    assert refused.reason.startswith("absolute-gauss-newton cannot image E3 (at 43.8 s): ")
    assert "did not converge" in refused.reason
    assert "noise_dB" in refused.remedy
