"""The lab's real recordings and the tank data, against what is known about them."""

import re

import numpy as np
import pytest
from shared_documents import document
from tiers import rest_but

from cbsr_qa.analysis.recording.analysis import AnalysisChoices, analyse_recording
from cbsr_qa.domain.readings.frames import ReadOptions
from cbsr_qa.plugin.discovery import discover
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser
from cbsr_qa_plugins.recordings.eidors_mat import EidorsMat

pytestmark = pytest.mark.shared


@pytest.mark.parametrize(
    ("name", "frames", "rate_hz", "rejected", "force"),
    [
        ("expABCX_150mm_8.5wt_6", 199, 4.23, [], False),
        ("expABX_100mm_9.5wt_6", 152, 4.25, [3], False),
        ("expABX_100mm_9.5wt_5", 91, 4.25, [], False),
        ("test_expABCD2_100mm_7.5wt_10s_3", 745, 7.96, [3, 845, 11588], True),
        ("test", 16, 8.2, [], True),
        ("testv2_12", 12, 4.22, [], True),
        ("steady_state_UoA1", 29, 1.57, [], True),
        ("redugraph1_cal1", 1281, 285, [4, 1476], False),
        ("no_batt", 287, 54, [], False),
    ],
)
def test_frames_rate_rejected_lines_and_force(board, name, frames, rate_hz, rejected, force):
    found = board(name)
    recording = found["recording"]
    assert found["exit"] == 0
    assert recording["frames"] == frames
    assert recording["rows_rejected"] == len(rejected)
    assert [p["line"] for p in recording["problems"] if p["rejected"]] == rejected
    assert recording["force_recorded"] is force
    assert recording["frame_rate_hz"] == pytest.approx(rate_hz, rel=0.02)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("test3", "only headers"),
        ("test4", "only headers"),
        ("test6", "only headers"),
        ("testv2_2", "no complete frame"),
        ("testv2_3", "no complete frame"),
        ("testv2_9", "no complete frame"),
        ("steady_state_calibrate", "no signal"),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_reason_and_a_remedy(board, name, reason):
    found = board(name)
    assert found["exit"] == 2
    assert reason in found["refused"]["reason"]
    assert found["refused"]["remedy"]
    assert not found.get("events")


def test_nothing_connected_still_says_what_was_read(board):
    found = board("steady_state_calibrate")
    assert found["recording"]["frames"] == 215
    assert found["channels"]["not_connected"]


@pytest.mark.parametrize(
    ("index", "start_s", "end_s", "electrode", "r_over_R"),
    [(0, 7.0, 17.5, None, 0.0), (1, 21.5, 31.5, 7.1, 0.45), (2, 36.5, 45.5, 2.5, 0.7)],
)
def test_three_presses_of_the_150_mm_sheet(board, index, start_s, end_s, electrode, r_over_R):
    events = board("expABCX_150mm_8.5wt_6")["events"]
    assert len(events) == 3
    event = events[index]
    assert event["start_s"] == pytest.approx(start_s, abs=1.0)
    assert event["end_s"] == pytest.approx(end_s, abs=1.5)
    assert event["start_s"] < event["peak_s"] <= event["end_s"]
    assert event["r_over_R"] == pytest.approx(r_over_R, abs=0.15)
    assert event["sign"] == -1
    if electrode is not None:
        assert event["electrode"] == pytest.approx(electrode, abs=0.5)
    assert "x_mm" not in event


def test_driven_pairs_clipped_at_zero_and_the_stuck_one(board):
    channels = board("expABCX_150mm_8.5wt_6")["channels"]
    assert channels["saturated"] == [[k, k] for k in range(16)]
    assert channels["stuck"] == [[0, 0]]


def test_the_weak_press_of_the_100_mm_sheet(board):
    (event,) = board("expABX_100mm_9.5wt_6")["events"]
    assert 8 < event["start_s"] < 14.5
    assert (event["electrode"] + 0.75) % 16 < 1.5  # between electrodes 15.25 and 0.75
    assert event["r_over_R"] == pytest.approx(0.65, abs=0.15)
    assert event["sign"] == -1


@pytest.mark.parametrize(
    "name", ["expABX_100mm_9.5wt_5", "test", "steady_state_UoA1", "test_expABCD2_100mm_7.5wt_10s_3", "testv2_12"]
)
def test_no_event_is_an_answer_with_a_reason(board, name):
    found = board(name)
    assert found["events"] == []
    assert found["events_why"]


@pytest.mark.parametrize(
    ("name", "before", "after", "share"),
    [("expABCX_150mm_8.5wt_6", 0.9, 0.5, 0.12), ("expABX_100mm_9.5wt_6", 0.58, 0.31, 0.138)],
)
def test_reading_memory_explains_most_of_the_reciprocity_error(board, name, before, after, share):
    channels = board(name)["channels"]
    assert channels["memory_corrected"]
    assert channels["reciprocity_error"] == pytest.approx(before, abs=0.02)
    assert channels["reciprocity_error_corrected"] == pytest.approx(after, abs=0.02)
    assert channels["reading_memory"] == pytest.approx(share, abs=0.02)


def test_a_source_at_its_limit_is_seen_in_one_of_eight_recordings(board):
    at_limit = board("res1k3_cal4")["channels"]["saturated"]
    assert at_limit == [[k, k] for k in range(16) if k not in (1, 2, 3)]
    for k in (1, 3, 6, 8, 12, 14, 16):
        assert board(f"res1k3_cal{k}")["channels"]["saturated"] == []


def test_outliers_are_counted_and_do_not_make_the_noise(board):
    assert board("res1k3_cal1")["noise"]["outliers"] == pytest.approx(0.035, abs=0.01)
    assert board("res1k3_cal1")["noise"]["rms"] < 2
    assert board("res1k3_cal4")["noise"]["outliers"] == 0


def test_the_level_step_without_battery(board):
    noise = board("no_batt")["noise"]
    (step,) = [step for step in noise["steps"] if step["what"] == "level"]
    assert step["first_frame_after"] == 94
    assert step["after"] - step["before"] == pytest.approx(5770, abs=80)
    assert noise["rms"] < 9


def test_bimodal_noise_is_told_apart(board):
    noise = board("test_expABCD2_100mm_7.5wt_10s_3")["noise"]
    assert noise["rms"] == pytest.approx(40, rel=0.1)
    assert min(step["after"] for step in noise["steps"]) == pytest.approx(5, rel=0.2)


@pytest.mark.parametrize(("dataset", "places"), [("vvAvg1", [None]), ("vvAvg2", [4.0]), ("vvAvg3", [0.0, 4.0])])
def test_phantom_b(tank, dataset, places):
    """Balls 7 cm from the centre of a pail with 26 cm of water, said to be 30 cm wide.

    The depth fitted to the reference says that where the electrodes are it is narrower: pails taper.
    """
    found = tank("phantom_16elec_1planeB.mat", dataset=dataset)
    (depth,) = [
        float(match[1]) for said in found["warnings"] if (match := re.search(r"tank ([\d.]+) radii deep", said))
    ]
    radius_cm = 26 / depth
    assert radius_cm == pytest.approx(14, abs=1)
    events = sorted(found["events"], key=lambda event: (event["electrode"] + 2) % 16)
    assert found["recording"]["frame_rate_hz"] is None
    assert len(events) == len(places)
    for event, electrode in zip(events, places, strict=True):
        assert event["sign"] == -1
        if electrode is None:
            assert event["r_over_R"] < 0.05
        else:
            assert abs((event["electrode"] - electrode + 8) % 16 - 8) <= 0.15
            assert event["r_over_R"] * radius_cm == pytest.approx(7, abs=0.75)


@pytest.mark.parametrize("name", ["phantom_16elec_1planeB.mat", "montreal_data_1995.mat"])
def test_a_file_of_several_data_sets_is_listed_and_refused(tank, name):
    found = tank(name)
    assert found["exit"] == 2
    assert len(found["datasets"]) >= 4
    assert all(dataset in found["refused"]["reason"] for dataset in found["datasets"])
    assert "--dataset" in found["refused"]["remedy"]


def test_the_rod_that_goes_round_never_goes_backwards(tank):
    found = tank("montreal_data_1995.mat", dataset="zc_demo3")
    (event,) = found["events"]
    track = np.array([[p["x_over_R"], p["y_over_R"]] for p in event["track"]])
    assert len(track) == 99
    angle = np.unwrap(np.arctan2(track[:, 1], track[:, 0])) * 16 / (2 * np.pi)
    assert (angle[0] % 16, angle[-1] - angle[0]) == pytest.approx((1.6, 14.8), abs=0.3)
    assert np.diff(angle).min() > -0.1
    assert np.hypot(*track.T).mean() == pytest.approx(0.49, abs=0.05)
    assert event["sign"] == -1
    assert "from electrode 1.6" in event["motion"]["words"]
    assert "once round, towards higher electrode numbers" in event["motion"]["words"]


def test_the_rod_that_goes_straight_through_the_centre(tank):
    (event,) = tank("montreal_data_1995.mat", dataset="zc_demo4")["events"]
    track = np.array([[p["x_over_R"], p["y_over_R"]] for p in event["track"]])
    assert len(track) == 33
    assert np.hypot(*track.T).argmin() == pytest.approx(16, abs=1)
    along = track[-1] - track[0]
    across = np.array([-along[1], along[0]]) / np.hypot(*along)
    assert np.abs(track @ across).max() < 0.06
    assert event["motion"]["words"].endswith("through the centre")


@pytest.mark.rest
@pytest.mark.parametrize(
    ("name", "sign", "places"),
    [("metal_1", 1, [0.0]), ("metal_2_180", 1, [0.0, 8.0]), ("plastic_2_90", -1, [0.0, 12.0])],
)
@pytest.mark.parametrize("water", [1, 3])
def test_rods_in_the_ds_tank(tank, shared, name, sign, places, water):
    empty = shared / "data" / "tank" / "ds_data_2004" / "homogeneous" / f"water_{water}.txt"
    events = tank(f"ds_data_2004/objects/{name}.txt", reference=empty)["events"]
    events = sorted(events, key=lambda event: (event["electrode"] + 2) % 16)
    assert len(events) == len(places)
    for event, electrode in zip(events, places, strict=True):
        assert event["sign"] == sign
        assert abs((event["electrode"] - electrode + 8) % 16 - 8) < 0.25


@pytest.mark.rest
def test_water_against_water_is_no_event_and_alone_is_refused(tank, shared):
    folder = shared / "data" / "tank" / "ds_data_2004" / "homogeneous"
    for one, other in ((2, 1), (3, 1), (3, 2)):
        found = tank(f"ds_data_2004/homogeneous/water_{one}.txt", reference=folder / f"water_{other}.txt")
        assert found["events"] == []
        assert "reciprocity" in found["events_why"]
    alone = tank("ds_data_2004/homogeneous/water_1.txt")
    assert alone["exit"] == 2
    assert "--reference" in alone["refused"]["remedy"]


@pytest.mark.parametrize("correct", rest_but({True}, [True, False]))
def test_reading_memory_can_be_forced_on_or_off_for_one_reason_only_the_places(shared, correct):
    format_ = discover().factory("recording", "ert-board-csv")()
    recording = format_.read(shared / "data" / "black_sensor" / "expABCX_150mm_8.5wt_6.csv", ReadOptions())
    result = analyse_recording(recording, GaussNewtonNoser(), AnalysisChoices(correct_carry_over=correct))
    assert result.channels.memory_corrected is correct
    assert len(result.events) == 3


@pytest.mark.rest
def test_chest_and_stomach_data_are_read_without_claiming_a_press(shared):
    path = shared / "data" / "tank" / "montreal_data_1995.mat"
    for dataset in EidorsMat().datasets(path):
        found = document(path, dataset)
        assert found["exit"] == (2 if found["recording"]["frames"] == 1 else 0)
