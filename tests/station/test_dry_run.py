"""The dry run: agrees with what the run then takes, and lists everything the station would not allow."""

from dataclasses import replace
from itertools import repeat

import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.config.loader import load_material, load_scene, load_sensor_type, load_station
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Home, MarkUnloaded, Press, Release, StrainStep
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.station.bench import Bench, Mounted
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import PlannedPhase, frames_in_hold, is_frame_worthwhile
from cbsr_qa.system.clock import VirtualClock, on_tick
from cbsr_qa.testing.bench import FixedSequence, Script, example_identity, example_plan, make_scripted_bench
from cbsr_qa_plugins.sequences.centre import HysteresisLoopSequence, NoiseFigureSequence
from cbsr_qa_plugins.sequences.places import LocationGridSequence, RandomLoadsSequence


def load(strain=0.2, x_mm=0.0, y_mm=0.0):
    return Load("L0", x_mm, y_mm, strain, 0)


def loop(*strains):
    """A press that is eased from strain to strain before it is released."""
    first, *others = strains
    eased = [step for strain in others for step in (StrainStep(strain), Hold(20, acquire=True))]
    return (Press(load(first)), Hold(20, acquire=True), *eased, Release(), Hold(20, acquire=True))


def cycle(**options):
    return (Press(load(**options)), Hold(60, acquire=True), Release(), Hold(60, acquire=True))


# --- agreement with the run ------------------------------------------------------------------------------


@given(hold_s=st.floats(0, 400), period_s=st.floats(0.02, 5), start_s=st.floats(0, 2e4))
def test_frames_of_a_hold_are_counted_as_they_are_taken(hold_s, period_s, start_s):
    clock, period_s = VirtualClock(), on_tick(period_s)
    clock.sleep(start_s)
    end_s, taken = clock.now() + hold_s, 0
    while taken == 0 or is_frame_worthwhile(end_s - clock.now(), period_s):
        clock.sleep(period_s)
        taken += 1
    share = hold_s / period_s % 1
    near_the_edge = abs(share - 0.1) < 1e-4  # the clock's ticks
    assert abs(taken - frames_in_hold(hold_s, period_s)) <= near_the_edge


def test_a_hold_of_whole_frames_takes_exactly_those():
    assert frames_in_hold(60.0, 2.5) == 24
    assert frames_in_hold(60.0, 2.56) == 24
    assert frames_in_hold(0.0, 2.5) == 1
    assert frames_in_hold(240.0, 0.025) == 9600


def moving_as_planned(plan):
    """A scripted bench whose head takes the time the station's motion says."""
    script = Script(VirtualClock())
    bench = make_scripted_bench(script, plan.sensor_type)
    head, clock, motion = bench.force_applicator, script.clock, plan.motion
    thickness_mm = plan.sensor_type.thickness_mm
    presses_s, releases_s, depth_mm = [], [], 0.0
    for step in (step for phase in plan.phases for step in phase.sequence.given):
        if isinstance(step, Press):
            depth_mm = step.load.strain * thickness_mm
            presses_s.append(kinematics.stroke_s(motion, depth_mm))
        elif isinstance(step, StrainStep):
            presses_s.append(abs(step.strain * thickness_mm - depth_mm) / motion.press_speed_mm_s)
            depth_mm = step.strain * thickness_mm
        elif isinstance(step, Release):
            releases_s.append(kinematics.stroke_s(motion, depth_mm))
    for name, took_s in (
        ("home", repeat(kinematics.homing_s(motion, plan.safety.travel_radius_mm))),
        ("press", presses_s),
        ("release", releases_s),
        ("find_surface", repeat(kinematics.surface_search_s(motion))),
    ):
        setattr(head, name, _taking(getattr(head, name), clock, iter(took_s)))
    return bench, clock


def _taking(method, clock, took_s):
    def call(*arguments):
        clock.sleep(next(took_s))
        return method(*arguments)

    return call


places = st.sampled_from(NINE_LOCATIONS_MM)
cycles = st.builds(cycle, strain=st.floats(0.01, 0.3))
loops = st.lists(st.floats(0.01, 0.3), min_size=1, max_size=5).map(lambda strains: loop(*strains))
plans = st.lists(cycles | loops, min_size=1, max_size=3).map(
    lambda cycles: (FindSurface(0, 0), Hold(7, acquire=False), MarkUnloaded(), AcquireFrames(3), *sum(cycles, ()))
)


@drawn(25)
@given(phases=st.lists(plans, min_size=1, max_size=2))
def test_time_by_kind_frames_and_loads_are_those_of_the_run(phases):
    plan = example_plan(*phases)
    bench, clock = moving_as_planned(plan)
    told = []
    dry = dry_run(plan, bench.frame_source.frame_period_s)
    ended = execute(plan, example_identity(), bench, clock, [told.append])
    assert ended.end is EndReason.FINISHED
    assert dict(ended.spent) == pytest.approx(dict(dry.spent))
    assert dry.frames == sum(isinstance(document, FramesTaken) for document in told)
    assert dry.loads == sum(isinstance(document, LoadFinished) for document in told)


@pytest.mark.rest
def test_time_agrees_with_the_simulated_bench():
    station = load_station("simulated").value
    plugins, clock = discover(), VirtualClock()
    context = StationContext(
        role="bench",
        clock=clock,
        sensor_type=load_sensor_type(station.sensor_type).value,
        material=load_material(station.material).value,
        indenter=station.indenter,
        seed=4,
        options={},
        scene=load_scene("base").value,
        effect_factory=lambda name: plugins.factory(Kind.EFFECT, name),
        motion=station.motion,
    )
    spec = station.instruments[0]
    bench = Bench([Mounted(spec, plugins.factory(Kind.INSTRUMENT, spec.driver)(context))])
    few = [list(place) for place in NINE_LOCATIONS_MM[:3]]
    plan = example_plan(
        PlannedPhase("noise", "noise-figure", NoiseFigureSequence(frames=16, trials=1)),
        PlannedPhase("grid", "location-grid", LocationGridSequence(locations_mm=few, hold_s=20, rest_s=20)),
        PlannedPhase("random", "random-loads", RandomLoadsSequence(count=2, hold_s=20, rest_s=20)),
        PlannedPhase("loop", "hysteresis-loop", HysteresisLoopSequence(hold_s=20, rest_s=20, cycles=2)),
    )
    dry = dry_run(plan, bench.frame_source.frame_period_s)
    ended = execute(plan, example_identity(), bench, clock, [lambda document: None])
    assert (ended.end, ended.detail) == (EndReason.FINISHED, "")
    assert ended.time_s == pytest.approx(dry.duration_s, rel=0.02)
    spent = dict(ended.spent)
    for kind, planned_s in dry.spent:
        if kind != "home":  # only the machine knows from where it homes
            assert spent[kind] == pytest.approx(planned_s, rel=0.06, abs=0.5), kind


def test_nine_locations_take_their_eighteen_minutes_and_what_goes_with_them():
    plan = example_plan(PlannedPhase("grid", "location-grid", LocationGridSequence()))
    dry = dry_run(plan, 2.5)
    spent = dict(dry.spent)
    assert spent["hold"] == 9 * 60
    assert spent["rest"] == 9 * 60 + 240
    assert spent["frames"] == 16 * 2.5
    assert (dry.loads, dry.frames) == (9, 16 + 9 * 48)
    assert dry.duration_s < 30 * 60


def test_travel_is_the_path_between_places():
    dry = dry_run(example_plan((*cycle(x_mm=30.0), *cycle(x_mm=-30.0))), 2.5)
    assert dry.travel_mm == pytest.approx(30 + 60)


def test_expected_peak_force_is_the_relaxed_force_and_what_relaxes():
    plan = example_plan(cycle(strain=0.2))
    weights = plan.material.stress_relaxation.weights
    relaxed_N = 132.5 * 0.2 * 132.732e-3  # kPa · mm² = mN: Table 1 of the paper, 8 wt%
    assert dry_run(plan, 2.5).peak_force_N == pytest.approx(relaxed_N * (1 + sum(weights)), rel=1e-4)
    creeping = replace(plan.material, stress_relaxation=replace(plan.material.stress_relaxation, weights=(0.5, -0.2)))
    assert dry_run(replace(plan, material=creeping), 2.5).peak_force_N == pytest.approx(relaxed_N * 1.5, rel=1e-4)


def test_a_loop_counts_its_deepest_strain_and_is_one_load():
    plan = example_plan(loop(0.1, 0.3, 0.1))
    dry = dry_run(plan, 2.5)
    assert (dry.loads, dry.peak_strain) == (1, 0.3)
    assert dry.peak_force_N == dry_run(example_plan(cycle(strain=0.3)), 2.5).peak_force_N
    eased_s = 2 * 0.2 * plan.sensor_type.thickness_mm / plan.motion.press_speed_mm_s
    one = dry_run(example_plan(cycle(strain=0.1)), 2.5)
    assert dict(dry.spent)["press"] == pytest.approx(dict(one.spent)["press"] + eased_s)


def test_durations_of_steps_add_up():
    dry = dry_run(example_plan(cycle(), cycle()), 2.5)
    assert sum(phase.duration_s for phase in dry.phases) == pytest.approx(dry.duration_s)


def test_done_loads_cost_nothing():
    plan = example_plan((*cycle(), *cycle()), cycle())
    all_of_it, rest = dry_run(plan, 2.5), dry_run(plan, 2.5, done=frozenset({(0, 0), (0, 1)}))
    assert rest.loads == 1
    assert rest.duration_s < all_of_it.duration_s - 240


# --- violations ------------------------------------------------------------------------------------------


def test_every_violation_is_listed_before_anything_moves():
    plan = example_plan(
        (*cycle(strain=0.36), *cycle(x_mm=42.1)), (FindSurface(0, 43.6), Hold(13 * 3600, acquire=False), *cycle())
    )
    dry = dry_run(plan, 2.5)
    said = "\n".join(dry.violations)
    assert "36 % strain; the station allows up to 35 %" in said
    assert "42.1 mm from the centre; the station allows 41 mm" in said
    assert "finding the surface at (0, 43.6) mm" in said
    assert "would reach 50.1 mm; the sheet ends at 50 mm" in said
    assert "the run takes 13.1 h; the station allows 12.0 h" in said
    with pytest.raises(RefusedError) as refused:
        dry.refuse()
    assert all(violation in refused.value.reason for violation in dry.violations)
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ((Press(load()), Press(load())), "the head is still down"),
        ((Press(load()), FindSurface(0, 0)), "the head is still down"),
        ((Press(load()), Home()), "the head is still down"),
        ((Press(load()), MarkUnloaded(), Release()), "not unloaded"),
        ((Press(load()),), "ends with the head down"),
        ((Release(),), "the head is not down"),
        ((StrainStep(0.2),), "going to 20 %: the head is not down"),
        ((*cycle(), StrainStep(0.2)), "going to 20 %: the head is not down"),
        (loop(0.1, 0.0), "0 % strain"),
        (loop(0.1, float("nan")), "nan % strain"),
        ((Press(load()), StrainStep(0.3)), "ends with the head down"),
        ((AcquireFrames(0),), "0 frames"),
        ((Hold(-1, acquire=True),), "hold_s is -1"),
        ((Hold(float("nan"), acquire=False),), "hold_s is nan"),
        ((Hold(float("inf"), acquire=False),), "hold_s is inf"),
        ((Press(load(strain=float("nan"))), Release()), "nan % strain"),
        ((Press(load(strain=0.0)), Release()), "0 % strain"),
        ((Press(load(x_mm=float("nan"))), Release()), "nan mm from the centre"),
        ((object(),), "does not know steps of type object"),
    ],
)
def test_steps_that_make_no_sense_are_refused(steps, said):
    dry = dry_run(example_plan(steps), 2.5)
    assert any(said in violation for violation in dry.violations)
    with pytest.raises(RefusedError):
        dry.refuse()


def test_a_loop_beside_the_sheet_is_refused_once_and_each_strain_for_itself():
    press, *rest = loop(0.1, 0.2, 0.3, 0.2, 0.1)
    plan = example_plan((Press(replace(press.load, x_mm=60.0)), *rest))
    refused = dry_run(plan, 2.5).violations
    assert refused
    assert all("60 mm from the centre" in one or "would reach" in one for one in refused)
    assert not any("going to" in one for one in refused)
    weak = replace(plan, safety=replace(plan.safety, strain=0.15))
    eased = [one for one in dry_run(weak, 2.5).violations if "going to" in one]
    assert [one.partition(" %")[0].rpartition(" ")[2] for one in eased] == ["20", "30"]


def test_a_limit_that_every_press_breaks_is_said_once():
    plan = example_plan(*[cycle(strain=0.3)] * 3, cycle(strain=0.31))
    weak = replace(plan, safety=replace(plan.safety, strain=0.25))
    first, other = dry_run(weak, 2.5).violations
    assert "30 % strain; the station allows up to 25 % (also at 2 later steps)" in first
    assert other.endswith("31 % strain; the station allows up to 25 %")


def test_plans_without_an_end_or_a_beginning_are_refused():
    class Endless:
        def steps(self, context):
            return repeat(Hold(1, acquire=False))

    with pytest.raises(RefusedError, match="more than 100000 steps"):
        dry_run(example_plan(PlannedPhase("p", "endless", Endless())), 2.5)
    with pytest.raises(RefusedError, match="no step"):
        dry_run(example_plan(PlannedPhase("p", "idle", FixedSequence(()))), 2.5)
    with pytest.raises(RefusedError, match="no phase"):
        dry_run(example_plan(), 2.5)
