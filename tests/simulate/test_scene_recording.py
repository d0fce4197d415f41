"""What is recorded of a scene, against closed forms: when heads press, what cell and frames see, what pauses do."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulated_setting import HEAD, installed, material, scene, sensor_type, world

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.plan.scene_plan import SceneLoad, ScenePlan, press_times
from cbsr_qa.domain.plan.world import Dump, SceneSetting, Transcript
from cbsr_qa.simulate.recording import (
    HEAD_BLOCK,
    frame_middles_s,
    frame_times_s,
    head_path,
    press_loads,
    record_scene,
)
from cbsr_qa.system.clock import TICK_S

MOTION = Motion(press_speed_mm_s=0.5, travel_speed_mm_s=10.0, hover_mm=20.2)
FIRST = SceneLoad(-20.0, 0.0, 0.2, 30.0, 15.0)
SECOND = SceneLoad(20.0, 10.0, 0.1, 80.0, 5.0)
OTHER_HEAD = SceneLoad(20.0, -10.0, 0.15, 35.0, 4.0, head=2)


def plan_of(
    *loads: SceneLoad, effects: tuple[str, ...] = (), duration_s: float = 100.0, **parameters: Any
) -> ScenePlan:
    coarse = replace(scene(*effects, **parameters), sheet_mesh_size_mm=8.0)
    return ScenePlan(coarse, indenter=HEAD, motion=MOTION, seed=1, duration_s=duration_s, loads=loads)


def recorded(plan: ScenePlan, effect_factory: Callable[[str], Callable[..., Any]] = installed):
    return record_scene(world(plan.scene, effect_factory=effect_factory), plan)


def _effect(perturbs: str, **methods: Callable[..., None]) -> Callable[..., Any]:
    made = {"needs": (), "perturbs": perturbs, "__init__": lambda self, setting: None, **methods}
    return type("Made", (), made)


# --- heads ---


def test_heads_press_when_and_where_they_are_told():
    plan = plan_of(SECOND, FIRST, OTHER_HEAD)
    here = world(plan.scene)
    pressed = press_loads(here, plan, 100.0)
    assert [one.load for one in pressed] == [SECOND, FIRST, OTHER_HEAD]
    for one in pressed:
        depth_mm = 4.0 * one.load.strain
        down, up = one.press.steps
        ramp_s = depth_mm / 0.5
        assert (one.press.x_mm, one.press.y_mm) == one.load.place_mm
        assert (down.start_s, down.ramp_s) == pytest.approx((one.load.start_s, ramp_s), abs=2 * TICK_S)
        assert (down.change, up.change) == pytest.approx((one.load.strain, -one.load.strain))
        assert up.start_s == pytest.approx(one.load.start_s + ramp_s + one.load.hold_s, abs=2 * TICK_S)
        assert one.true_strain == pytest.approx(one.load.strain)


def test_what_is_noted_of_a_press_has_closed_forms():
    first, second = (one.record for one in press_loads(world(scene()), plan_of(FIRST, SECOND), 100.0))
    assert first.load.label == "L0"
    stroke_s = 20.0 / 10 + 0.2 / 0.5  # fast to 0.2 mm above the sheet, then at the press speed
    assert first.press_start_s == pytest.approx(30.0 - stroke_s)
    assert first.hold_start_s == pytest.approx(30.0 + 0.8 / 0.5)
    assert first.release_start_s == pytest.approx(first.hold_start_s + 15.0)
    assert first.clear_s == pytest.approx(first.release_start_s + 0.8 / 0.5)
    assert first.release_end_s == pytest.approx(first.clear_s + stroke_s)
    assert (first.rest_end_s, second.rest_end_s) == (second.press_start_s, 100.0)


def test_movements_of_every_head_have_addresses_of_their_own():
    seen = []
    position = _effect("position", apply=lambda self, moment: seen.append(moment.index))
    plan = plan_of(FIRST, SECOND, OTHER_HEAD, effects=("watch",))
    press_loads(world(plan.scene, effect_factory=lambda name: position), plan, 100.0)
    assert HEAD_BLOCK == 1 << 24
    assert len(set(seen)) == len(seen)
    first, second = [i for i in seen if i < HEAD_BLOCK], [i for i in seen if i >= HEAD_BLOCK]
    assert len(first) == 2 * len(second) > 0
    assert max(second) < 2 * HEAD_BLOCK


def test_a_press_that_would_go_through_the_sheet_is_refused():
    def higher(self, moment):
        moment.surface_mm -= 1.0

    plan = plan_of(FIRST, replace(SECOND, strain=0.8), effects=("seat",))
    with pytest.raises(RefusedError, match=r"loads\[2\] would strain the sheet by 105 %"):
        recorded(plan, lambda name: _effect("geometry", apply=higher))


def test_a_head_that_does_not_reach_the_sheet_presses_nothing():
    def lower(self, moment):
        moment.surface_mm += 0.5

    plan = plan_of(FIRST, SECOND, effects=("seat",))
    first, second = recorded(plan, lambda name: _effect("geometry", apply=lower)).pressed
    assert first.true_strain == pytest.approx((0.8 - 0.5) / 4)
    assert (second.press, second.true_strain) == (None, 0.0)


def test_the_path_of_the_first_head_is_the_rigs_x_y_z():
    plan = plan_of(SECOND, FIRST, OTHER_HEAD)
    times = press_times(FIRST, 0.8, MOTION)
    at_s = [0.0, 1.0, 2.0, times.leaves_s, times.leaves_s + 1.0, 30.0, times.down_s, times.lifts_s, times.up_s, 79.0]
    x, y, z = head_path(plan, 4.0, np.array(at_s))
    assert [(block.channel, block.unit) for block in (x, y, z)] == [("x", "mm"), ("y", "mm"), ("z", "mm")]
    # Over the centre at first, then at 10 mm/s to the place of the load; afterwards at once to the next one.
    np.testing.assert_allclose(x.values, [0, -10, -20, -20, -20, -20, -20, -20, -20, 20], atol=1e-9)
    np.testing.assert_allclose(y.values, [0, 0, 0, 0, 0, 0, 0, 0, 0, 10], atol=1e-9)
    np.testing.assert_allclose(z.values[:9], [0, 0, 0, 0, -10, -20.2, -21, -21, 0], atol=1e-9)
    assert z.values[9] == pytest.approx(-20.2 + 0.4 * 0.5 + 0.6 * 10)  # a second before it touches, 0.4 s of it slow


# --- force and frames ---


def test_the_cell_reads_the_sum_of_all_heads():
    both = recorded(plan_of(FIRST, OTHER_HEAD, effects=("elastic-stress",))).recording.samples[0]
    np.testing.assert_array_equal(both.time_s, np.arange(801) / 8)
    newton = material().modulus_kPa.value * HEAD.area_mm2 * 1e-3  # at a strain of 1
    for time_s, strain in (
        (29.0, 0.0),
        (30.5, 0.2 * 0.5 / 1.6),
        (38.0, 0.2 + 0.15),
        (47.0, 0.2 - 0.2 * 0.4 / 1.6),
        (60.0, 0),
    ):
        assert both.values[int(8 * time_s)] == pytest.approx(newton * strain, abs=newton * TICK_S), time_s


def test_frames_are_those_of_the_world_at_their_times():
    plan = plan_of(FIRST, effects=("piezoresistivity", "measurement-noise"), duration_s=60.0)
    done = recorded(plan)
    frames = done.recording.frames
    assert frame_middles_s(plan).tolist() == [2.5 * k + 1.25 for k in range(24)]
    np.testing.assert_array_equal(frames.time_s, frame_middles_s(plan))
    again = world(plan.scene)
    press_loads(again, plan, 60.0)
    for k in (23, 0, 14):
        np.testing.assert_array_equal(frames.voltages[k], again.voltages_V(2.5 * k + 1.25, k))
    assert (done.frames_lost, len(done.transcript.dumps)) == (0, 0)
    assert (done.recording.sensor_type, done.recording.clock) == ("disc-100mm", "station")
    assert [record.load.label for record in done.recording.loads] == ["L0"]


def test_several_loads_are_noted_in_the_order_of_time():
    assert [r.load.label for r in recorded(plan_of(SECOND, FIRST, OTHER_HEAD)).recording.loads] == ["L1", "L2", "L0"]


# --- pauses ---


def _transcript(*dumps: Dump, frames: int = 4) -> Transcript:
    setting = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)
    transcript = Transcript.complete(setting, 2.5 * np.arange(frames) + 1.25)
    transcript.dumps += dumps
    return transcript


def test_frames_without_pauses_are_where_they_were_planned():
    transcript = _transcript()
    times_s, row_pauses_s = frame_times_s(transcript)
    np.testing.assert_array_equal(times_s, transcript.time_s)
    assert not row_pauses_s.any()


@pytest.mark.parametrize(("row", "own_s"), [(0, 0.5), (3, 0.5), (8, 0.5), (9, 0.0), (15, 0.0)])
def test_a_pause_moves_its_frame_if_it_comes_before_the_middle_row(row: int, own_s: float):
    times_s, row_pauses_s = frame_times_s(_transcript(Dump(1, row, 0.5)))
    np.testing.assert_allclose(times_s - (2.5 * np.arange(4) + 1.25), [0, own_s, 0.5, 0.5])
    # Whatever a frame's time, its rows are read when they are: late from the dump on.
    late = (times_s - (2.5 * np.arange(4) + 1.25))[:, None] + row_pauses_s
    expected = np.zeros((4, 16))
    expected[1, row:] = expected[2:] = 0.5
    np.testing.assert_allclose(late, expected, atol=1e-12)


def test_readings_behind_a_pause_are_taken_late_and_the_recording_ends_later():
    def pause(self, transcript):
        transcript.lost[2, 5] = True
        transcript.dumps += [Dump(1, 3, 0.5), Dump(2, 12, 0.25)]

    made = {"pause": _effect("recording", record=pause), "time-skew": installed("time-skew")}
    done = recorded(plan_of(effects=("time-skew", "pause"), duration_s=12.0), made.__getitem__)
    frames = done.recording.frames
    assert (len(frames), done.frames_lost) == (4, 1)
    planned = 2.5 * np.arange(4)[:, None] + 2.5 * (np.arange(256) + 0.5) / 256
    late = np.zeros((4, 16))
    late[1, 3:] = 0.5
    late[2:] = 0.5
    late[2, 12:] = late[3] = 0.75
    expected = planned.reshape(4, 16, 16) + late[:, :, None]
    np.testing.assert_allclose(frames.reading_time_s, expected, atol=1e-12)
    force = done.recording.samples[0]
    assert force.time_s[-1] == pytest.approx(10.75)  # 4 frames of 2.5 s and both pauses


def test_samples_are_taken_along_with_the_frames_so_that_progress_is_true():
    asked: list[str] = []

    def sampled(moment):
        asked.append("sample")

    plan = plan_of(duration_s=50.0, effects=("sampled",))
    here = world(plan.scene, effect_factory=lambda name: _effect("force", apply=lambda self, moment: sampled(moment)))
    counts: list[int] = []
    done = record_scene(here, plan, progress=lambda done, of: counts.append(len(asked)))
    (force,) = (block for block in done.recording.samples if block.channel == "force")
    assert len(asked) == len(force) == 8 * 50 + 1
    assert max(np.diff([0, *counts])) <= 8 * 2.5 + 1
    assert counts[-1] == len(asked)
