"""Loads followed over streams of frames that are known exactly: exact readings, relaxing as kernels say."""

from dataclasses import replace

import numpy as np
import pytest
from force_samples import HEAD, NOISE, in_use, learned, line, pressed, setting, smooth_response, somewhere

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.settling_forces import SettlingForces
from cbsr_qa.calibration.runtime.track import Track
from cbsr_qa.calibration.runtime.tracking import ForceStream, LoadState
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.eit.loads.round_load import RoundLoads

FRAME_S = 2.5
STEADY_S = 55.0


def kernel(loading, weights, time_constants_s):
    return RelaxationKernel(
        loading, np.array(weights), np.array(time_constants_s), 1e-5 * np.eye(4), np.full(2, 0.01), 20.0, 30
    )


LOADING = kernel(True, [-0.2, -0.55], [2.5, 23.1])
UNLOADING = kernel(False, [0.2, 0.62], [2.5, 25.4])


def share(kernel_, held_s):
    return float(np.sum(kernel_.weights * np.exp(-held_s / kernel_.time_constants_s)))


@pytest.fixture(scope="module")
def response():
    return smooth_response(3, 0.15)


@pytest.fixture(scope="module")
def calibration(response):
    random = np.random.default_rng(1)
    result = learned(pressed(random, response, somewhere(random, 40), random.uniform(1.5, 5, 40)))
    model = replace(result.model, steady_s=STEADY_S, loading=LOADING, unloading=UNLOADING)
    return in_use(model, result.line)


class Press:
    """A head that presses from one time to another, and what it leaves."""

    def __init__(self, place_mm, force_N, from_s, to_s, response):
        self.place_mm, self.force_N, self.from_s, self.to_s = np.array([place_mm]), force_N, from_s, to_s
        stress = force_N / HEAD.area_mm2 * 1e3
        held = 1 + share(LOADING, STEADY_S)
        self.size = float(response(self.place_mm)[0]) * (line().slope.value * stress) / held

    def contrast(self, time_s):
        if time_s < self.from_s:
            return 0.0
        if time_s < self.to_s:
            return self.size * (1 + share(LOADING, time_s - self.from_s))
        return self.size * (1 + share(LOADING, self.to_s - self.from_s)) * share(UNLOADING, time_s - self.to_s)


def stream(presses, until_s, seed=0):
    """Times and frames; the loads' changes add up, which for loads apart they do to second order."""
    random = np.random.default_rng(seed)
    here = setting()
    for time_s in np.arange(FRAME_S / 2, until_s, FRAME_S):
        frame = here.model.solve_unloaded() + NOISE * random.standard_normal(here.used.shape)
        for press in presses:
            contrast = press.contrast(time_s)
            if contrast:
                frame = frame + here.voltages(press.place_mm, np.array([contrast]))[0]
        yield float(time_s), frame


def followed(calibration, presses, until_s, seed=0):
    tracker = ForceStream(calibration)
    return {time_s: tracker.update(time_s, frame) for time_s, frame in stream(presses, until_s, seed)}


def pressing(loads):
    return [load for load in loads if load.state in (LoadState.LOADING, LoadState.STEADY)]


def at(seen, time_s):
    return seen[min(seen, key=lambda known: abs(known - time_s))]


@pytest.fixture(scope="module")
def seen(calibration, response):
    return followed(calibration, [Press((12.0, 7.0), 3.0, 20.0, 90.0, response)], 300.0)


class TestOneLoad:
    """Pressed from 20 to 90 s with 3 N."""

    def test_states_follow_each_other_from_the_press_until_it_has_faded(self, seen):
        assert all(not loads for time_s, loads in seen.items() if time_s < 20)
        states = [loads[0].state.value for loads in seen.values() if loads]
        assert list(dict.fromkeys(states))[:3] == ["loading", "steady", "unloading"]
        assert {loads[0].number for loads in seen.values() if loads} == {1}
        assert at(seen, 295.0) == ()

    def test_times_of_press_and_release_are_known_to_a_frame(self, seen):
        assert at(seen, 60.0)[0].since_s == pytest.approx(20.0, abs=FRAME_S)
        assert at(seen, 100.0)[0].since_s == pytest.approx(90.0, abs=FRAME_S)

    @pytest.mark.parametrize(("after_s", "error_N"), [(10.0, 0.45), (25.0, 0.3), (60.0, 0.15)])
    def test_force_is_predicted_from_the_first_frames(self, seen, after_s, error_N):
        load = pressing(at(seen, 20.0 + after_s))[0]
        assert load.force_N == pytest.approx(3.0, abs=error_N)
        assert abs(load.force_N - 3.0) < 4 * load.stderr_N
        assert np.hypot(load.place_mm[0] - 12, load.place_mm[1] - 7) < 1.5
        assert load.flags == (Flag.UNSETTLED if after_s < 45 else Flag(0))

    def test_what_is_left_is_no_force_and_unsettled_until_it_is_noise(self, seen):
        soon, later = at(seen, 97.0)[0], at(seen, 100.0)[0]
        assert (soon.force_N, soon.stderr_N) == (0.0, 0.0)
        assert soon.left_N > 0.5
        assert later.flags & Flag.UNSETTLED
        assert 10.0 < later.settled_in_s < 100.0

    def test_time_until_it_counts_runs_down(self, seen):
        loads = [pressing(at(seen, 20.0 + after_s))[0] for after_s in (12.5, 22.5, 60.0)]
        assert loads[0].settled_in_s - loads[1].settled_in_s == pytest.approx(10.0, abs=2.0)
        assert 15.0 < loads[1].settled_in_s < 32.5
        assert loads[2].settled_in_s == 0


def test_two_loads_at_once_and_one_on_what_another_left(calibration, response):
    presses = [
        Press((15.0, 5.0), 3.0, 20.0, 90.0, response),
        Press((-18.0, -10.0), 4.0, 60.0, 130.0, response),
        Press((15.0, 5.0), 2.5, 150.0, 220.0, response),
    ]
    seen = followed(calibration, presses, 230.0)
    both, (second,), (third,) = (pressing(at(seen, time_s)) for time_s in (88.0, 128.0, 218.0))
    assert [load.force_N for load in both] == [pytest.approx(3.0, abs=0.25), pytest.approx(4.0, abs=0.5)]
    assert second.force_N == pytest.approx(4.0, abs=0.25)
    assert third.force_N == pytest.approx(2.5, abs=0.25)
    assert third.number == 3


def test_a_load_that_was_there_when_the_stream_began_is_not_taken_for_a_new_one(calibration, response):
    press = Press((12.0, 7.0), 3.0, -200.0, 500.0, response)
    seen = followed(calibration, [press], 70.0)
    early, late = (pressing(at(seen, time_s))[0] for time_s in (12.0, 68.0))
    assert abs(early.force_N - 3.0) < 3 * early.stderr_N
    assert early.force_N == pytest.approx(3.0, rel=0.15)
    assert (early.flags, late.flags) == (Flag.UNSETTLED, Flag(0))


@pytest.fixture(scope="module")
def judged(calibration, response):
    press = Press((12.0, 7.0), 3.0, 20.0, 110.0, response)
    seen = dict(stream([press], 160.0))
    times, frames = np.array([*seen]), np.array([*seen.values()])
    alone = calibration.force(frames)
    settling = SettlingForces(calibration)
    parts = [settling(times[some], frames[some], alone.part(some)) for some in (slice(0, 30), slice(30, None))]
    force, stderr, flags = (
        np.concatenate([getattr(forces, name) for forces, _ in parts]) for name in ("force_N", "stderr_N", "flags")
    )
    return times, alone, force, stderr, flags, np.concatenate([settled_in_s for _, settled_in_s in parts])


class TestSettlingForces:
    """Frames of a recording, each by itself, with those that have not settled flagged."""

    def test_forces_that_count_are_right_and_others_flagged(self, judged):
        times, alone, force, stderr, flags, _ = judged
        truth = np.where((times > 20) & (times < 110), 3.0, 0.0)
        wrong = np.abs(alone.force_N - truth) > 3 * alone.stderr_N + 0.05
        assert ((alone.flags == 0) & wrong).sum() > 10
        assert not ((flags == 0) & (np.abs(force - truth) > 3 * stderr + 0.05)).any()
        unsettled = flags & Flag.UNSETTLED != 0
        assert (np.abs(force - truth)[unsettled] < 3 * stderr[unsettled] + 0.05).mean() > 0.95

    def test_frames_of_a_settled_load_are_as_they_were(self, judged):
        times, alone, force, _, flags, settled_in_s = judged
        held = (times > 70) & (times < 110)
        np.testing.assert_array_equal(force[held], alone.force_N[held])
        assert not flags[held].any()
        assert not settled_in_s[held].any()
        assert settled_in_s[(times > 25) & (times < 40)].min() > 10

    def test_no_frames(self, calibration):
        none = calibration.force(np.zeros((0, 16, 16)))
        forces, settled_in_s = SettlingForces(calibration)(np.zeros(0), np.zeros((0, 16, 16)), none)
        assert len(forces.force_N) == len(settled_in_s) == 0


class Steps(Press):
    """A head whose force is added to or lessened while it presses; changes add up as those of single presses do."""

    def __init__(self, place_mm, steps, response):
        super().__init__(place_mm, 1.0, 0.0, np.inf, response)
        self.steps = steps

    def contrast(self, time_s):
        size = 0.0
        for from_s, change_N in self.steps:
            if time_s >= from_s:
                kernel_, sign = (LOADING, 1) if change_N > 0 else (UNLOADING, -1)
                size += change_N * (1 + sign * share(kernel_, time_s - from_s))
        return self.size * size


@pytest.mark.parametrize(("first_N", "then_N"), [(1.5, 1.5), (4.0, -2.0)], ids=["doubled", "halved"])
def test_a_load_that_changes_while_it_presses_is_known_less_surely_and_not_wrongly(
    calibration, response, first_N, then_N
):
    head = Steps((15.0, 5.0), [(20.0, first_N), (100.0, then_N)], response)
    seen = followed(calibration, [head], 260.0)
    before, soon, late = (pressing(at(seen, time_s)) for time_s in (98.0, 125.0, 250.0))
    assert [len(loads) for loads in (before, soon, late)] == [1, 1, 1]
    assert before[0].force_N == pytest.approx(first_N, abs=0.2)
    for loads in (soon, late):
        assert abs(loads[0].force_N - first_N - then_N) < 3 * loads[0].stderr_N
    assert soon[0].stderr_N > 3 * before[0].stderr_N
    assert late[0].force_N == pytest.approx(first_N + then_N, abs=0.2)
    assert late[0].since_s == pytest.approx(20, abs=FRAME_S)


@pytest.mark.parametrize("part", [0.12, -0.12])
def test_a_small_change_that_creeps_in_is_noticed(calibration, response, part):
    head = Steps((15.0, 5.0), [(20.0, 3.0), (90.0, 3.0 * part)], response)
    seen = followed(calibration, [head], 160.0)
    before, after = (pressing(at(seen, time_s)) for time_s in (88.0, 125.0))
    assert len(before) == len(after) == 1
    assert after[0].stderr_N > 1.5 * before[0].stderr_N
    assert abs(after[0].force_N - 3.0 * (1 + part)) < 3 * after[0].stderr_N


@pytest.mark.rest
def test_a_head_seen_on_its_way_down_does_not_become_two(calibration, response):
    # A tenth of the load in the frame in which it touches: that frame is 9 mm off in its place.
    head = Steps((11.3, 25.5), [(18.8, 0.12), (20.1, 1.13)], response)
    for seed in range(6):
        seen = followed(calibration, [head], 60.0, seed=seed)
        load = pressing(at(seen, 58.0))
        assert len(load) == 1
        assert load[0].force_N == pytest.approx(1.25, abs=0.15)


@pytest.mark.rest
def test_stated_errors_are_honest_over_many_loads(calibration, response):
    random = np.random.default_rng(17)
    scores = []
    for number in range(40):
        force = random.uniform(1.0, 5.0)
        press = Press(somewhere(random, 1, 35.0)[0], force, 10.0, 100.0, response)
        seen = followed(calibration, [press], 66.0, seed=number)
        load = pressing(at(seen, 65.0))
        scores.append((load[0].force_N - force) / load[0].stderr_N)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5


def test_a_frame_that_cannot_be_read_keeps_what_is_known(calibration, response):
    tracker = ForceStream(calibration)
    for time_s, frame in stream([Press((0.0, 10.0), 3.0, 5.0, 90.0, response)], 40.0):
        before = tracker.update(time_s, frame)
    told = tracker.update(time_s + FRAME_S, np.full_like(frame, np.nan))
    assert told[0].flags & Flag.UNREADABLE
    assert told[0].force_N == pytest.approx(before[0].force_N)


class TestFrames:
    """Frames looked at by themselves."""

    def test_known_and_found_place(self, calibration, response):
        press = Press((-20.0, 14.0), 4.0, 0.0, 500.0, response)
        frames = np.array([frame for time_s, frame in stream([press], 66.0) if 50 < time_s < 60])
        known = calibration.force(frames, place_mm=(-20.0, 14.0))
        found = calibration.force(frames)
        for forces in (known, found):
            assert forces.force_N == pytest.approx(np.full(len(frames), 4.0), abs=0.5)
            assert (forces.flags == 0).all()
        assert (known.place_stderr_mm == 0).all()
        assert (found.place_stderr_mm > 0).all()
        low, high = known.interval_N(0.95)
        assert (low < 4.0).all()
        assert (high > 4.0).all()

    def test_flags(self, calibration, response):
        here = setting()
        light = here.model.solve_unloaded()
        heavy = light + here.voltages(np.array([[5.0, 5.0]]), np.array([0.4]))[0]
        wrong = light + here.voltages(np.array([[5.0, 5.0]]), np.array([-0.1]))[0]
        two = light + here.voltages(np.array([[25.0, 5.0], [-25.0, 0.0]]), np.array([0.15, 0.15])).sum(axis=0)
        foreign, broken = 3 * light, light.copy()
        broken[: len(broken) // 2 + 2] = np.nan
        forces = calibration.force(np.array([light, heavy, wrong, two, foreign, broken]))
        flags = [Flag(int(flag)) for flag in forces.flags]
        assert flags[0] == Flag.NOT_DETECTED
        assert flags[1] & Flag.ABOVE_RANGE
        assert flags[2] & Flag.WRONG_SIGN
        assert flags[3] & Flag.MORE_THAN_ONE
        assert flags[4] == Flag.OTHER_SENSOR
        assert flags[5] == Flag.UNREADABLE
        assert forces.force_N[0] == 0
        assert forces.stderr_N[0] == calibration.least_force_N
        assert np.isnan(forces.force_N[4:]).all()
        outside = calibration.force(heavy, place_mm=(0.0, 41.0))
        assert Flag(int(outside.flags[0])) & Flag.OUTSIDE

    def test_a_load_that_does_not_show_is_within_what_is_stated(self, calibration, response):
        # The centre shows least: what is missed there must not be said to be known to be nothing.
        stress = 0.6 * calibration.least_force_N / HEAD.area_mm2 * 1e3
        contrast = response(np.zeros((1, 2))) * line().slope.value * stress
        here, random = setting(), np.random.default_rng(4)
        noise = NOISE * random.standard_normal((200, *here.used.shape))
        forces = calibration.force(here.model.solve_unloaded() + here.voltages(np.zeros((1, 2)), contrast) + noise)
        missed = forces.flags == Flag.NOT_DETECTED
        assert missed.mean() > 0.5
        assert (np.abs(forces.force_N - 0.6 * calibration.least_force_N)[missed] < forces.stderr_N[missed]).all()

    def test_current_scales_frames(self, calibration):
        here = setting()
        frame = here.model.solve_unloaded() + here.voltages(np.array([[5.0, 5.0]]), np.array([0.1]))[0]
        one, half = calibration.force(frame), calibration.force(frame / 2, current_A=0.5)
        assert half.force_N == pytest.approx(one.force_N, rel=1e-9)

    @pytest.mark.parametrize("diameter_mm", [9.0, 17.0])
    def test_another_head_presses_as_hard(self, calibration, diameter_mm):
        # A force is stress × area: of the same force a wider head makes a fainter, larger change.
        here, place, head = setting(), np.array([[8.0, -4.0]]), Indenter(diameter_mm)
        contrast = np.array([0.1 * HEAD.area_mm2 / head.area_mm2])
        loads = RoundLoads.from_contrast(place, np.array([head.radius_mm]), contrast)
        frame = here.model.solve_unloaded() + here.model.readings(loads).change[0]
        usual = here.model.solve_unloaded() + here.voltages(place, np.array([0.1]))[0]
        expected = calibration.force(usual, place_mm=place[0]).force_N[0]
        found = calibration.force(frame, place_mm=place[0], indenter=head)
        assert found.force_N[0] == pytest.approx(expected, rel=0.01)
        taken_for_the_usual = calibration.force(frame, place_mm=place[0]).force_N[0]
        assert taken_for_the_usual == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize(
    ("time_s", "frames", "said"),
    [
        *((wrong, 1, "its time must be a finite number") for wrong in (np.inf, -np.inf, np.nan, "1", None, 1j)),
        (0.0, 1, "time must go forward"),
        (1.0, 2, "one after the other"),
    ],
)
def test_what_is_no_next_frame_is_refused_and_the_stream_goes_on(calibration, time_s, frames, said):
    stream, reference = ForceStream(calibration), calibration.issued.reference
    stream.update(0.0, reference)
    with pytest.raises(CalibrationError, match=said):
        stream.update(time_s, reference if frames == 1 else np.array([reference] * frames))
    assert stream.update(1.0, reference) == ()


@pytest.mark.parametrize("most", [0, -1, 2.5, np.nan, "all"])
def test_a_number_of_loads_that_counts_nothing_is_refused(calibration, most):
    with pytest.raises(CalibrationError, match="a stream cannot follow"):
        ForceStream(calibration, most=most)


def test_a_place_with_an_error_that_is_none_is_not_learned_from():
    track = Track(1, np.array([3.0, 4.0]), np.ones(5), 0.0, 0.0, 1.0)
    track.add_place(np.array([9.0, 9.0]), np.diag([1.0, -1.0]))
    track.add_place(np.array([9.0, 9.0]), -np.eye(2))
    assert track.place_mm.tolist() == [3.0, 4.0]
    track.add_place(np.array([5.0, 6.0]), np.eye(2))
    assert track.place_mm == pytest.approx([5.0, 6.0])


def test_what_is_left_where_no_head_can_be_is_flagged(calibration):
    stream = ForceStream(calibration)
    track = Track(1, np.array([0.6, -46.4]), calibration.filter.template(np.zeros((1, 2)))[0], 0.0, 0.0, 1.0)
    track.state, track.strength = "unloading", 0.01
    told = stream._report(track, Flag(0))
    assert np.isfinite(told.left_N) or Flag.OUTSIDE in told.flags
    track.place_mm = np.array([0.0, 60.0])
    told = stream._report(track, Flag(0))
    assert np.isnan(told.left_N)
    assert Flag.OUTSIDE in told.flags
