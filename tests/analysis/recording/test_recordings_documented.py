"""The table of known recordings: what it says of each is what ``analyse`` finds in it."""

import re
from pathlib import Path

import pytest
from tiers import rest_but

pytestmark = pytest.mark.shared

PAGE = (Path(__file__).parent / "known_recordings.md").read_text(encoding="utf-8")


def row(name):
    """The line of the table that begins with this name, in plain words."""
    (found,) = [
        line for line in PAGE.splitlines() if line.startswith(f"| `{name}") or line.startswith(f"| … `{name}")
    ]
    return found.replace("`", "")


def cells(name):
    return [cell.strip() for cell in row(name).strip("|").split(" | ")]


def rejected_in_words(recordings):
    lines = [[str(problem["line"]) for problem in each["problems"] if problem["rejected"]] for each in recordings]
    return ", ".join(f"{len(each)} ({', '.join(each)})" if each else "0" for each in lines)


def where(event):
    return f"{event['electrode']:.2f}", f"{event['r_over_R']:.2f}"


def test_the_table_says_what_is_found_of_the_150_mm_sheet(board):
    found, said = board("expABCX_150mm_8.5wt_6"), row("expABCX_150mm_8.5wt_6")
    assert cells("expABCX_150mm_8.5wt_6")[1:3] == ["199", f"{found['recording']['frame_rate_hz']:.2f}"]
    for event in found["events"]:
        assert f"{event['start_s']:.1f}–{event['end_s']:.1f} s at" in said
    for event in found["events"][1:]:
        assert "electrode {}, r/R {}".format(*where(event)) in said
    assert f"at the centre (r/R {where(found['events'][0])[1]})" in said
    assert said.endswith(memory_in_words(found["channels"]))
    dumps = [problem for problem in found["recording"]["problems"] if "watchdog" in problem["what"]]
    assert f"0 ({len(dumps)} dumps noted)" in said


def memory_in_words(channels):
    share, before, after = (
        channels[key] for key in ("reading_memory", "reciprocity_error", "reciprocity_error_corrected")
    )
    error = "reciprocity error " if before > 0.8 else ""
    return f"memory {100 * share:.1f} %, {error}{before:.2f} → {after:.2f} |"


def test_the_table_says_what_is_found_of_the_100_mm_sheet(board):
    found, said = board("expABX_100mm_9.5wt_6"), row("expABX_100mm_9.5wt_6")
    (event,) = found["events"]
    assert f"from {event['start_s']:.1f} s to the end, electrode {where(event)[0]}, r/R {where(event)[1]}" in said
    assert said.endswith(memory_in_words(found["channels"]))


@pytest.mark.rest
def test_the_table_says_the_noise_and_why_there_is_no_event(board):
    found = board("expABX_100mm_9.5wt_5")
    said = row("expABX_100mm_9.5wt_5")
    assert re.search(r"the largest step is [\d.]+ times its noise, [\d.]+ is needed", found["events_why"])[0] in said
    assert f"noise {found['noise']['rms']:.2f} counts" in said
    bimodal = board("test_expABCD2_100mm_7.5wt_10s_3")
    quiet = min(step["after"] for step in bimodal["noise"]["steps"])
    assert f"noise {bimodal['noise']['rms']:.1f} counts, {quiet:.1f} in two" in row("test_expABCD2_100mm")
    assert sum(step["after"] == quiet for step in bimodal["noise"]["steps"]) == 2


@pytest.mark.parametrize("name", ["test_expABCD2_100mm_7.5wt_10s_3", "test", "steady_state_UoA1"])
def test_the_table_says_the_reciprocity_error_that_hinders(board, name):
    found, said = board(name), row(f"{name}.csv")
    assert f"({found['channels']['reciprocity_error']:.2f}" in said
    assert f"{found['channels']['reciprocity_error']:.2f};" in found["events_why"]
    assert f"{found['recording']['frame_rate_hz']:.2f}" in cells(f"{name}.csv")[2]


def test_the_table_says_what_hinders_in_the_short_recordings(board):
    late, said = board("testv2_12"), row("testv2_12.csv")
    assert re.search(r"change at [\d.]+ s", late["events_why"])[0].removeprefix("change ") in said
    assert int(re.search(r"explain (\d+)%", late["events_why"])[1]) < 25
    younger = [re.search(r"up to [\d.]+ s", note) for note in late["recording"]["notes"]]
    assert any(match and match[0] in said for match in younger)
    share = board("steady_state_UoA1")["channels"]["reading_memory"]
    assert f"the share of {100 * share:.1f} %" in row("steady_state_UoA1.csv")


@pytest.mark.rest
def test_the_table_says_frames_rates_and_rejected_lines_of_the_one_row_recordings(board):
    numbers = (1, 3, 4, 6, 8, 12, 14, 16)
    _, frames, rates, rejected, result = cells("res1k3_cal1")
    found = [board(f"res1k3_cal{k}") for k in numbers]
    recordings = [each["recording"] for each in found]
    assert frames == ", ".join(str(each["frames"]) for each in recordings)
    hertz = [each["frame_rate_hz"] for each in recordings]
    assert rates == f"{min(hertz):.0f}–{max(hertz):.0f}"
    assert rejected == rejected_in_words(recordings)
    outliers = [100 * each["noise"]["outliers"] for each in found if each["noise"]["outliers"]]
    assert len(outliers) == len(numbers) - 1
    assert f"{min(outliers):.1f} to {max(outliers):.1f} % upward outliers" in result
    (step,) = [step for step in board("no_batt")["noise"]["steps"] if step["what"] == "level"]
    assert f"level step of {step['after'] - step['before']:+.0f} counts before frame 94" in row("no_batt.csv")


@pytest.mark.rest
def test_the_table_says_how_many_rows_the_short_files_have(board):
    files = ("testv2_2", "testv2_3", "testv2_9")
    said = row("testv2_2.csv")
    reasons = [board(name)["refused"]["reason"] for name in files]
    good = [re.search(r"(\d+) good rows", reason)[1] for reason in reasons]
    assert "({}, {} and {} good rows)".format(*good) in said
    lines = [[str(p["line"]) for p in board(name)["recording"]["problems"] if p["rejected"]] for name in files]
    assert cells("testv2_2.csv")[3] == ", ".join(
        f"{len(each)} ({', '.join(each)})" if each else "0" for each in lines
    )
    for name in ("steady_state_calibrate", "no_batt", "redugraph1_cal1"):
        read = board(name)["recording"]
        assert cells(f"{name}.csv")[1:3] == [str(read["frames"]), f"{read['frame_rate_hz']:.0f}"]


@pytest.mark.parametrize("dataset", rest_but({"vvAvg3"}, ["vvAvg1", "vvAvg2", "vvAvg3"]))
def test_the_table_says_where_the_balls_are(tank, dataset):
    found, said = tank("phantom_16elec_1planeB.mat", dataset=dataset), row(dataset)
    events = sorted(found["events"], key=lambda event: (event["electrode"] + 2) % 16)
    electrodes, radii = zip(*(where(event) for event in events), strict=True)
    if dataset != "vvAvg1":
        plural = "s" if len(events) > 1 else ""
        assert f"electrode{plural} {' and '.join(electrodes)}, r/R {' and '.join(radii)}" in said
    else:
        assert f"r/R {radii[0]}" in said
    if dataset == "vvAvg2":
        (deep,) = [match for told in found["warnings"] if (match := re.search(r"([\d.]+) radii deep", told))]
        assert f"depth {deep[1]} radii" in said


@pytest.mark.rest
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("metal_1", "electrode {0}, r/R {r}, conducts more"),
        ("metal_2_180", "electrodes {0} and {1}, conduct more"),
        ("plastic_2_90", "electrodes {0} and {1}, conduct less"),
    ],
)
def test_the_table_says_where_the_rods_are(tank, shared, name, told):
    empty = shared / "data" / "tank" / "ds_data_2004" / "homogeneous" / "water_1.txt"
    found = tank(f"ds_data_2004/objects/{name}.txt", reference=empty)
    electrodes = [f"{event['electrode']:.1f}" for event in found["events"]]
    assert told.format(*electrodes, r=where(found["events"][0])[1]) in row(f"{name}.txt")
    assert found["recording"]["rows_rejected"] == 1
