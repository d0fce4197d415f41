"""What a scene file says of its recording, and what it may not say."""

import re

import pytest
from scene_samples import HEAD, PIEZORESISTIVE, checked, load_table, written

from cbsr_qa.config.documents import DocumentKind, list_shipped
from cbsr_qa.config.loader import (
    load_material,
    load_recipe,
    load_scene,
    load_scene_plan,
    load_sensor_type,
    load_station,
)
from cbsr_qa.config.merging import merge, restore
from cbsr_qa.config.scene_checks import edge_remarks
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.steps import CLEARANCE_MM
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.studies.scenes.setting import make_world, set_up


def test_a_scene_says_what_is_recorded(tmp_path):
    head = "[head]\npress_speed_mm_per_min = 60.0\noutline_mm = [[-4, -3], [4, -3], [4, 3], [-4, 3]]\n\n"
    loads = load_table(start_s=60.0) + load_table(x_mm=9.0, start_s=20.0, hold_s=5.0, head=2) + load_table(hold_s=1.0)
    plan = checked(written(tmp_path, HEAD + head + loads)).value
    assert (plan.sensor_type, plan.material, plan.seed, plan.duration_s) == ("disc-100mm", "cbsr-8wt", 7, 100.0)
    assert plan.indenter.area_mm2 == pytest.approx(48)
    assert plan.motion.press_speed_mm_s == pytest.approx(1.0)
    assert (plan.motion.travel_speed_mm_s, plan.motion.hover_mm) == (10.0, 25.0)  # the rig's
    assert plan.frame_count == 40
    assert [load.strain for load in plan.loads] == pytest.approx([0.2] * 3)
    by_head = {head: [load.start_s for load in loads] for head, loads in plan.heads().items()}
    assert by_head == {1: [20.0, 60.0], 2: [20.0]}


def test_a_scene_for_a_station_needs_nothing_more(tmp_path):
    plan = load_scene_plan(written(tmp_path, HEAD.split("[sensor]")[0])).value
    assert (plan.sensor_type, plan.material, plan.seed, plan.duration_s, plan.loads) == (None, None, None, None, ())
    assert plan.frame_count == 0


def test_what_a_station_does_not_use_changes_no_configuration(tmp_path):
    def digest(text):
        written(tmp_path, text, "lively.toml")
        station = load_station("simulated").document.text.replace('scene = "base"', 'scene = "lively"')
        at = load_station(written(tmp_path, station, "mine.toml"))
        sensor_type, material = load_sensor_type("disc-100mm"), load_material("cbsr-8wt")
        merged = merge(at, load_recipe("nine-locations"), sensor_type, material, seed=5)
        assert restore(merged.canonical).station == merged.station
        return merged.digest

    of_station = HEAD.split("[sensor]")[0] + PIEZORESISTIVE
    assert digest(HEAD + load_table() + PIEZORESISTIVE) == digest(of_station)
    assert digest(of_station.replace("0.4", "0.3")) != digest(of_station)


@pytest.mark.parametrize(
    ("table", "key", "found", "allowed"),
    [
        ({"strain_percent": 0}, "loads[2].strain_percent", "is 0", "above 0"),
        ({"strain_percent": 100.0}, "loads[2].strain_percent", "is 100", "below 100"),
        ({"hold_s": 0.0}, "loads[2].hold_s", "is 0", "above 0"),
        ({"hold_s": -2.0}, "loads[2].hold_s", "is -2", "above 0"),
        ({"hold_s": '"30 s"'}, "loads[2].hold_s", "is '30 s'", "a number"),
        ({"hold_ms": 30.0}, "loads[2].hold_ms", "not a known key", "did you mean 'hold_s'"),
        ({"x_cm": 3.0}, "loads[2].x_cm", "not a known key", "did you mean 'x_mm'"),
        ({"head": 0}, "loads[2].head", "is 0", "from 1"),
        ({"x_mm": 51.0}, "loads[2].x_mm", "is 51", "the sheet ends 50 mm from its centre"),
        ({"x_mm": "nan"}, "loads[2].x_mm", "", "not a finite number"),
        ({"start_s": -1.0}, "loads[2].start_s", "is -1", "from 0"),
        ({"hold_s": 60.0}, "loads[2].hold_s", "up at 125.18 s", "duration_s is 100; it must be at least 125.18"),
    ],
)
def test_a_load_that_cannot_be_is_refused_by_its_key(tmp_path, table, key, found, allowed):
    path = written(tmp_path, HEAD + load_table() + load_table(**({"start_s": 60.0} | table)))
    with pytest.raises(ConfigError) as refused:
        checked(path)
    line = next(line for line in refused.value.reason.splitlines() if key in line)
    assert str(path) in refused.value.reason
    assert found in line
    assert allowed in line


_OUTLINE = "outline_mm = [[0, 0], [9, 0], [0, 9]]"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("duration_s = 100.0", "duration_s = 1.0", "recording.duration_s is 1; one frame takes 2.5 s"),
        ("duration_s = 100.0", "duration_s = 1e6", "recording.duration_s is 1e+06, 400000 frames of 2.5 s; at most"),
        ("duration_s = 100.0", "duration_min = 2.0", "did you mean 'duration_s'"),
        ("[recording]", "[recordings]", "recordings is not a known key; did you mean 'recording'"),
        ("seed = 7", "seed = -7", "recording.seed is -7"),
        ("seed = 7", "seed = 2147483648", "recording.seed is 2147483648"),
        ("[recording]", "[head]\nhover_mm = 0.1\n\n[recording]", "head.hover_mm is 0.1"),
        ("[recording]", f"[head]\ndiameter_mm = 9.0\n{_OUTLINE}\n\n[recording]", "head.diameter"),
        ("sheet_mesh_size_mm = 8.0", "sheet_mesh_size_mm = 0.1", "sheet_mesh_size_mm is 0.1; on this sheet it must"),
    ],
)
def test_a_recording_that_cannot_be_is_refused_by_its_key(tmp_path, old, new, said):
    assert old in HEAD
    with pytest.raises(ConfigError, match=re.escape(said)):
        checked(written(tmp_path, HEAD.replace(old, new)))


def _start_that_works(error):
    return float(re.search(r"(?:earliest start that works is|start this one at) ([\d.]+)", error.reason)[1])


@pytest.mark.parametrize(
    ("first", "second", "named"),
    [
        ({"x_mm": 30.0, "start_s": 0.0}, {"start_s": 60.0}, "loads[1].start_s is 0; head 1 needs"),
        ({}, {"x_mm": 30.0, "start_s": 54.0}, "loads[2].start_s is 54; head 1 is busy with loads[1] until"),
        ({}, {"x_mm": 12.0, "start_s": 54.0, "head": 2}, "loads[2] puts head 2 12 mm from loads[1], where head 1"),
    ],
)
def test_the_earliest_start_that_is_stated_works_and_is_the_earliest(tmp_path, first, second, named):
    """Travel, approach, press, hold and lift take the time that the station's motion says."""

    def scene(**moved):
        tables = [first | moved, second] if "loads[1].start_s" in named else [first, second | moved]
        return written(tmp_path, HEAD + "".join(load_table(**table) for table in tables))

    with pytest.raises(ConfigError, match=re.escape(named)) as refused:
        checked(scene())
    earliest = _start_that_works(refused.value)
    checked(scene(start_s=earliest))
    with pytest.raises(ConfigError, match=re.escape(f"{named[:8]}")):
        checked(scene(start_s=earliest - 0.011))


def test_the_earliest_start_has_a_closed_form(tmp_path):
    with pytest.raises(ConfigError) as refused:
        checked(written(tmp_path, HEAD + load_table() + load_table(x_mm=30.0, start_s=54.0)))
    slow_s = CLEARANCE_MM / (40 / 60)
    stroke_s = (25 - CLEARANCE_MM) / 10 + slow_s
    up_s = 20 + 0.8 / (40 / 60) + 30 + 0.8 / (40 / 60) + stroke_s
    assert _start_that_works(refused.value) == pytest.approx(up_s + 30 / 10 + stroke_s, abs=0.01)


@pytest.mark.parametrize(
    ("head", "apart", "meets"),
    [
        ("diameter_mm = 13.0", (12.99, 0.0), True),
        ("diameter_mm = 13.0", (13.0, 0.0), False),
        ("diameter_mm = 13.0", (9.2, 9.2), False),
        ("outline_mm = [[0, 0], [10, 0], [10, 10], [0, 10]]", (9.9, 9.9), True),
        ("outline_mm = [[0, 0], [10, 0], [10, 10], [0, 10]]", (10.0, 0.0), False),
        # An L stands in the corner of another without touching it, though their hulls overlap.
        ("outline_mm = [[0, 0], [10, 0], [10, 2], [2, 2], [2, 10], [0, 10]]", (3.0, 3.0), False),
        ("outline_mm = [[0, 0], [10, 0], [10, 2], [2, 2], [2, 10], [0, 10]]", (1.0, 1.0), True),
    ],
)
def test_two_heads_press_at_one_time_but_not_in_one_place(tmp_path, head, apart, meets):
    loads = load_table() + load_table(*apart, start_s=40.0, hold_s=5.0, head=2)
    path = written(tmp_path, HEAD + f"[head]\n{head}\n\n" + loads)
    if not meets:
        checked(path)
        return
    with pytest.raises(ConfigError, match=r"loads\[2\] puts head 2 .* two heads .* would overlap"):
        checked(path)


def test_a_head_partly_over_the_edge_is_remarked_upon(tmp_path):
    loads = load_table(x_mm=43.4) + load_table(x_mm=43.6, start_s=70.0, hold_s=5.0)
    plan = checked(written(tmp_path, HEAD + loads)).value
    remarks = edge_remarks(plan, load_sensor_type("disc-100mm").value)
    assert list(remarks) == [1]
    assert "loads[2]" in remarks[1]
    assert "(43.6, 0) mm" in remarks[1]


def test_a_scene_that_cannot_be_recorded_says_which_lines_to_add(tmp_path):
    bare = HEAD.split("[sensor]")[0]
    with pytest.raises(ConfigError, match=r"has no \[sensor\] and no \[recording\]") as refused:
        set_up(str(written(tmp_path, bare)), recorded=True)
    lines = refused.value.remedy.partition("\n")[2]
    set_up(str(written(tmp_path, bare + lines)), recorded=True)
    set_up(str(written(tmp_path, bare)), recorded=False)


@pytest.mark.parametrize(
    ("effects", "reason", "remedy"),
    [
        ('name = "piezoresistive"', "no effect plugin named 'piezoresistive'", "did you mean 'piezoresistivity'"),
        ('name = "load-cell-noise"\nrms_mN = 1.0', "rms_mN is not a known key", "did you mean 'rms_N'"),
        ('name = "residue"\nshare = 0.1\ndecay_s = -9.0', "decay_s is -9", "above 0"),
        ('name = "conductance-relaxation"', "without 'piezoresistivity'", "add [[effects]]"),
    ],
)
def test_a_wrong_effect_is_refused_with_the_scenes_file(tmp_path, effects, reason, remedy):
    path = written(tmp_path, HEAD + f"[[effects]]\n{effects}\n")
    setup = set_up(str(path), recorded=True)
    plugins = discover()
    with pytest.raises(ConfigError, match=re.escape(reason)) as refused:
        make_world(setup, lambda name: plugins.factory(Kind.EFFECT, name), seed=7)
    assert refused.value.reason.startswith(f"{path}: ")
    assert remedy in refused.value.remedy


@pytest.mark.parametrize("name", list_shipped(DocumentKind.SCENE))
def test_every_shipped_scene_can_be_recorded_and_used_by_a_station(name):
    setup = set_up(name, recorded=True)
    assert setup.plan.seed == 7
    assert load_scene(name).value == setup.plan.scene
    remarked = edge_remarks(setup.plan, setup.sensor_type.value)
    assert len(remarked) == (name == "strip")  # whose head is as wide as itself


def test_the_scene_with_everything_lists_every_built_in_effect():
    built_in = {r.name for r in discover().registrations(Kind.EFFECT) if r.distribution == "cbsr-qa"}
    assert {choice.name for choice in load_scene("everything").value.effects} == built_in
