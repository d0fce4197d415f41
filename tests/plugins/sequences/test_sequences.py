"""Sequences: the same steps each time, unloaded frames before every load, options refused with what is allowed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import chisquare

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.steps import (
    AcquireFrames,
    FindSurface,
    Hold,
    LowerHover,
    MarkUnloaded,
    Press,
    Release,
    Role,
    Settle,
    StrainStep,
    TouchPlane,
)
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.plugin.interfaces import AdaptiveSequence, PressGoal
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.testing.bench import example_plan
from cbsr_qa_plugins.sequences.adaptive import AdaptiveGridSequence
from cbsr_qa_plugins.sequences.centre import (
    HysteresisLoopSequence,
    NoiseFigureSequence,
    PreconditioningSequence,
    RelaxationSequence,
)
from cbsr_qa_plugins.sequences.parts import plan_rests_s, predict_residue
from cbsr_qa_plugins.sequences.places import LocationGridSequence, RandomLoadsSequence

ALL = (NoiseFigureSequence, LocationGridSequence, RandomLoadsSequence, RelaxationSequence)


def steps_of(sequence, seed=0):
    return list(sequence.steps(example_plan([], seed=seed).context))


def loads_of(sequence, seed=0):
    return [step.load for step in steps_of(sequence, seed) if isinstance(step, Press)]


sequences = st.one_of(
    st.builds(NoiseFigureSequence, trials=st.integers(1, 4), frames=st.integers(16, 60), recovery_s=st.floats(0, 90)),
    st.builds(
        LocationGridSequence,
        trials=st.integers(1, 3),
        strains_percent=st.lists(st.floats(1, 30), min_size=1, max_size=3, unique=True),
        find_surface=st.booleans(),
        initial_rest_s=st.floats(0, 300),
    ),
    st.builds(RandomLoadsSequence, count=st.integers(1, 12), rest_s=st.floats(0, 90), stream=st.sampled_from("ab")),
    st.builds(RelaxationSequence, x_mm=st.floats(-30, 30), trials=st.integers(1, 3)),
)


def test_every_sequence_says_what_it_is_for():
    assert [sequence().role for sequence in ALL] == [Role.NOISE, Role.GRID, Role.RANDOM, Role.RELAXATION]


@pytest.mark.rest
@given(sequence=sequences, seed=st.integers(0, 2**40))
def test_the_same_steps_each_time(sequence, seed):
    assert steps_of(sequence, seed) == steps_of(sequence, seed)


@given(sequence=sequences)
def test_every_load_is_pressed_held_released_after_unloaded_frames(sequence):
    steps = steps_of(sequence)
    first_press = next(i for i, step in enumerate(steps) if isinstance(step, Press))
    marked = steps.index(MarkUnloaded())
    assert marked < first_press
    unloaded = [step for step in steps[marked:first_press] if isinstance(step, AcquireFrames)]
    assert sum(step.count for step in unloaded) >= 16  # eight for the noise floor, eight for the reference
    for i, step in enumerate(steps):
        if isinstance(step, Press):
            assert isinstance(steps[i + 1], Hold)
            assert steps[i + 1].acquire
            assert steps[i + 2] == Release()
    assert not any(isinstance(step, FindSurface) for step in steps[first_press:])


def test_surfaces_are_found_where_loads_will_be_and_the_sheet_rests_after():
    steps = steps_of(LocationGridSequence(trials=2))
    assert [(s.x_mm, s.y_mm) for s in steps[:9]] == list(NINE_LOCATIONS_MM)
    assert steps[9] == Hold(240.0, acquire=False)
    random = RandomLoadsSequence()
    found = {(s.x_mm, s.y_mm) for s in steps_of(random) if isinstance(s, FindSurface)}
    assert found == {(load.x_mm, load.y_mm) for load in loads_of(random)}


def test_grid_presses_every_location_strain_and_trial_once():
    loads = loads_of(LocationGridSequence(strains_percent=[5, 10.0], trials=3))
    assert len(set(loads)) == len(loads) == 9 * 2 * 3
    for load in loads:
        assert (load.x_mm, load.y_mm) == NINE_LOCATIONS_MM[int(load.label[1:])]
        assert load.strain in (0.05, 0.10)
    # A place rests while the eight others are pressed.
    assert [load.label for load in loads[:10]] == [f"L{i}" for i in range(9)] + ["L0"]


def test_an_adaptive_grid_lists_each_place_once_with_its_surface_and_says_when_it_ends():
    sequence = AdaptiveGridSequence(target_N=0.15, count=20, radius_mm=30, at_most=12, area_strain_percent=[5, 20.0])
    assert isinstance(sequence, AdaptiveSequence)
    assert sequence.role is Role.GRID
    assert sequence.goal == PressGoal(0.15, 6, 12, 40.0, (0.05, 0.2), 0.8)
    steps, loads = steps_of(sequence), loads_of(sequence)
    assert len({(load.x_mm, load.y_mm) for load in loads}) == 20
    assert all(math.hypot(load.x_mm, load.y_mm) <= 30 for load in loads)
    for number, step in enumerate(steps):
        if isinstance(step, Press):
            assert steps[number - 1] == FindSurface(step.load.x_mm, step.load.y_mm)


def test_an_adaptive_grid_takes_unloaded_frames_or_leaves_them_to_an_earlier_phase():
    assert steps_of(AdaptiveGridSequence(target_N=0.1))[:3] == [
        Hold(240.0, acquire=False),
        MarkUnloaded(),
        AcquireFrames(16),
    ]
    without = AdaptiveGridSequence(
        target_N=0.1, unloaded_frames=0, initial_rest_s=0, locations_mm=NINE_LOCATIONS_MM, at_most=9
    )
    assert [type(step) for step in steps_of(without)[:3]] == [FindSurface, Press, Hold]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "target_N"),
        ({"target_N": 0}, "target_N is 0"),
        ({"target_N": 0.1, "at_least": 9, "at_most": 8}, "at_most is 8"),
        ({"target_N": 0.1, "count": 20}, "at_most is 24"),
        ({"target_N": 0.1, "locations_mm": [[0, 0.0]]}, "locations_mm gives 1 places"),
        ({"target_N": 0.1, "confidence": 0.4}, "confidence is 0.4"),
        ({"target_N": 0.1, "unloaded_frames": 5}, "unloaded_frames"),
    ],
)
def test_an_adaptive_grid_names_what_is_wrong(options, said):
    with pytest.raises(ConfigError, match=said):
        AdaptiveGridSequence(**options)


def test_preconditioning_works_in_one_place_after_the_other_and_leaves_the_reference_to_others():
    sequence = PreconditioningSequence(cycles=3, strain_percent=25, locations_mm=[[0, 0], [10, -5.0]])
    assert sequence.role is Role.PRECONDITIONING
    steps = steps_of(sequence)
    assert steps == steps_of(sequence)
    loads = loads_of(sequence)
    assert [(load.label, load.trial) for load in loads] == [(f"L{k}", cycle) for k in range(2) for cycle in range(3)]
    assert {load.strain for load in loads} == {0.25}
    assert steps[:2] == [FindSurface(0.0, 0.0), FindSurface(10.0, -5.0)]
    assert not any(isinstance(step, MarkUnloaded | AcquireFrames) for step in steps)
    for i, step in enumerate(steps):
        if isinstance(step, Press):
            assert steps[i + 1 : i + 4] == [Hold(10.0, acquire=True), Release(), Hold(10.0, acquire=True)]
    assert len(loads_of(PreconditioningSequence())) == 5 * 9


def test_a_loop_reaches_every_strain_from_below_and_from_above_without_lifting():
    sequence = HysteresisLoopSequence(
        strains_percent=[5, 10.0, 20], cycles=2, locations_mm=[[0, 0], [10, 5]], rest_s=9
    )
    assert sequence.role is Role.LOOP
    steps = steps_of(sequence)
    assert steps == steps_of(sequence)
    assert steps[:2] == [FindSurface(0.0, 0.0), FindSurface(10.0, 5.0)]
    assert [(load.label, load.trial) for load in loads_of(sequence)] == [("H0", 0), ("H0", 1), ("H1", 0), ("H1", 1)]
    marked, first = steps.index(MarkUnloaded()), next(i for i, s in enumerate(steps) if isinstance(s, Press))
    assert steps[marked:first] == [MarkUnloaded(), AcquireFrames(16)]
    hold = Hold(60.0, acquire=True)
    for i, step in enumerate(steps):
        if isinstance(step, Press):
            assert step.load.strain == 0.05
            eased = [StrainStep(0.1), hold, StrainStep(0.2), hold, StrainStep(0.1), hold, StrainStep(0.05), hold]
            assert steps[i + 1 : i + 12] == [hold, *eased, Release(), Hold(9.0, acquire=True)]


def test_grids_name_their_places_as_they_are_told():
    assert [load.label for load in loads_of(LocationGridSequence(label="C"))] == [f"C{k}" for k in range(9)]


def test_noise_figure_follows_its_definition():
    steps = steps_of(NoiseFigureSequence())
    assert steps[:4] == [FindSurface(0.0, 0.0), Hold(240.0, acquire=False), MarkUnloaded(), AcquireFrames(30)]
    assert [(x.label, x.strain, x.trial) for x in loads_of(NoiseFigureSequence())] == [
        ("L0", 0.2, t) for t in range(3)
    ]


@given(seed=st.integers(0, 2**63), low=st.floats(0, 20), wide=st.floats(0, 20))
def test_random_loads_stay_in_their_ranges(seed, low, wide):
    sequence = RandomLoadsSequence(count=20, radius_mm=[low, low + wide], strain_percent=[5, 30])
    for load in loads_of(sequence, seed):
        radius_mm = math.hypot(load.x_mm, load.y_mm)
        assert low - 0.015 <= radius_mm <= low + wide + 1e-9
        assert 0.05 <= load.strain <= 0.30
        assert round(load.x_mm, 2) == load.x_mm
        assert round(100 * load.strain, 2) == pytest.approx(100 * load.strain, abs=1e-12)


@pytest.mark.rest
def test_random_loads_are_uniform_in_radius_angle_and_strain():
    loads = loads_of(RandomLoadsSequence(count=10_000), seed=3)
    x, y, strain = np.array([(load.x_mm, load.y_mm, load.strain) for load in loads]).T
    for name, share in {
        "radius": np.hypot(x, y) / 40,  # uniform in area would have a mean of 2/3
        "angle": np.mod(np.arctan2(y, x), 2 * np.pi) / (2 * np.pi),
        "strain": (strain - 0.05) / 0.25,
    }.items():
        assert share.mean() == pytest.approx(0.5, abs=5 / math.sqrt(12 * 10_000)), name
        assert chisquare(np.histogram(share, bins=10, range=(0, 1))[0]).pvalue > 4e-4, name


def test_random_loads_are_addressed_by_seed_and_name():
    ten = loads_of(RandomLoadsSequence(count=10), seed=1)
    assert ten[0] == Load("R0", 12.72, -14.81, 0.1833, 0)  # in any process, of any version
    assert loads_of(RandomLoadsSequence(count=4), seed=1) == ten[:4]
    assert not set(loads_of(RandomLoadsSequence(count=10), seed=2)) & set(ten)
    assert not set(loads_of(RandomLoadsSequence(count=10, stream="others"), seed=1)) & set(ten)


@pytest.mark.parametrize(("x", "label"), [(0.0, "L0"), (30, "L1"), (12.5, "X0")])
def test_relaxation_is_labelled_by_its_place(x, label):
    load = loads_of(RelaxationSequence(x_mm=x, strain_percent=10))[0]
    assert (load.label, load.strain) == (label, 0.1)


@pytest.mark.parametrize(
    ("sequence", "options", "said"),
    [
        (LocationGridSequence, {"rest_s": -1}, "rest_s is -1"),
        (LocationGridSequence, {"trials": 0}, "trials is 0"),
        (LocationGridSequence, {"strains_percent": []}, "strains_percent is"),
        (LocationGridSequence, {"strains_percent": [0]}, "strains_percent[1] is 0"),
        (LocationGridSequence, {"strains_percent": [10, 61]}, "strains_percent[2] is 61"),
        (LocationGridSequence, {"strains_percent": [10, 10.0]}, "strains_percent is"),
        (LocationGridSequence, {"locations_mm": [[0, 0, 0]]}, "locations_mm[1] is"),
        (LocationGridSequence, {"label": ""}, "label is ''"),
        (PreconditioningSequence, {"cycles": 1}, "cycles is 1"),
        (PreconditioningSequence, {"rest_s": 0}, "rest_s is 0"),
        (PreconditioningSequence, {"locations_mm": [[1, 1], [1, 1]]}, "locations_mm is"),
        (HysteresisLoopSequence, {"strains_percent": [20]}, "strains_percent is [20]"),
        (HysteresisLoopSequence, {"strains_percent": [10, 20, 10]}, "strains_percent is [10, 20, 10]"),
        (HysteresisLoopSequence, {"strains_percent": [10, 10.0]}, "strains_percent is [10, 10.0]"),
        (HysteresisLoopSequence, {"strains_percent": [0, 10]}, "strains_percent[1] is 0"),
        (HysteresisLoopSequence, {"hold_s": 0}, "hold_s is 0"),
        (HysteresisLoopSequence, {"locations_mm": [[1, 1], [1, 1]]}, "locations_mm is"),
        (LocationGridSequence, {"unloaded_frames": 15}, "unloaded_frames is 15"),
        (NoiseFigureSequence, {"frames": 15}, "frames is 15"),
        (RandomLoadsSequence, {"radius_mm": [10]}, "radius_mm is"),
        (RandomLoadsSequence, {"radius_mm": [10, 5]}, "radius_mm is"),
        (RandomLoadsSequence, {"strain_percent": [0, 5]}, "strain_percent[1] is 0"),
        (RandomLoadsSequence, {"strain_percent": [0.05, 3]}, "strain_percent[1] is 0.05"),
        (NoiseFigureSequence, {"strain_percent": 0.99}, "strain_percent is 0.99"),
        (RandomLoadsSequence, {"count": 0}, "count is 0"),
        (RandomLoadsSequence, {"stream": " "}, "stream is ' '"),
    ],
)
def test_options_out_of_range_are_refused_with_what_is_allowed(sequence, options, said):
    with pytest.raises(ConfigError) as refused:
        sequence(**options)
    assert said in refused.value.reason
    assert refused.value.remedy.startswith("it must ")


def test_a_place_given_twice_is_refused_with_the_option_that_repeats():
    with pytest.raises(ConfigError, match="cycles repeats them"):
        HysteresisLoopSequence(locations_mm=[[0, 0], [0.0, 0.0]])


def test_a_strain_that_was_meant_as_a_fraction_is_told_in_per_cent():
    with pytest.raises(ConfigError, match=r"strains_percent\[1\] is 0\.2") as refused:
        LocationGridSequence(strains_percent=[0.2])
    assert refused.value.remedy == "it must be a number from 1 to 60, in per cent: write 20 for the fraction 0.2"


# --- less time per press ---------------------------------------------------------------------------------


def test_by_default_every_place_is_found_and_every_rest_is_fixed():
    steps = steps_of(LocationGridSequence(rest_s=40.0))
    assert {type(step) for step in steps} == {FindSurface, Hold, MarkUnloaded, AcquireFrames, Press, Release}
    assert {step.hold_s for step in steps if isinstance(step, Hold)} == {240.0, 60.0, 40.0}


@pytest.mark.parametrize(
    ("options", "places"),
    [
        ({"locations_mm": NINE_LOCATIONS_MM}, {(30.0, 0.0), (-30.0, 0.0), (0.0, 30.0), (0.0, -30.0)}),
        ({"locations_mm": [(0, 0), (30, 0), (0, 30), (5, 5)]}, {(0, 0), (30, 0), (0, 30)}),
        ({"touches_mm": [(1, 2), (20, 2), (3, 30)]}, {(1, 2), (20, 2), (3, 30)}),
    ],
)
def test_a_plane_is_touched_at_three_places_far_apart(options, places):
    touches = [
        step for step in steps_of(LocationGridSequence(surface="plane", **options)) if type(step) is TouchPlane
    ]
    assert len(touches) == 3
    assert {(touch.x_mm, touch.y_mm) for touch in touches} <= places


def test_where_an_earlier_phase_took_the_unloaded_frames_four_are_enough():
    steps = steps_of(LocationGridSequence(unloaded_before=True))
    assert [step.count for step in steps if isinstance(step, AcquireFrames)] == [4]


@pytest.mark.parametrize("places", [[(0, 0)], [(0, 0), (20, 0)], [(0, 0), (20, 0.1), (30, 0)]])
def test_places_in_a_line_span_no_plane(places):
    with pytest.raises(ConfigError, match="lie less than 5 mm from a line"):
        steps_of(LocationGridSequence(surface="plane", locations_mm=places))
    if len(places) == 3:
        with pytest.raises(ConfigError, match="lie less than 5 mm from a line"):
            steps_of(LocationGridSequence(surface="plane", touches_mm=places))


def test_options_that_give_no_steps_are_named_with_their_phase():
    sequence = LocationGridSequence(surface="plane", locations_mm=[(0, 0)])
    phase = PlannedPhase("three places", "location-grid", sequence)
    with pytest.raises(ConfigError, match=r"phase 'three places': surface = .* from a line"):
        list(phase.steps(example_plan([]).context))


@given(
    share=st.floats(0.1, 20),
    least_s=st.floats(0, 20),
    seed=st.integers(0, 100),
)
def test_rests_are_the_shortest_after_which_the_predicted_residue_is_small(share, least_s, seed):
    context = example_plan([], seed=seed).context
    loads = loads_of(RandomLoadsSequence(count=6), seed)
    rests_s = plan_rests_s(loads, context, share=share / 100, hold_s=15.0, least_s=least_s, most_s=90.0)
    assert rests_s[-1] == 90.0
    for number, following in enumerate(loads[1:]):
        released = loads[: number + 1]

        def residue(rest_s, number=number, released=released, following=following):
            ages_s = [sum(15.0 + rest for rest in rests_s[k:number]) + rest_s for k in range(number + 1)]
            return predict_residue(released, ages_s, following, context) / following.strain

        rest_s = rests_s[number]
        assert least_s <= rest_s <= 90.0
        assert residue(rest_s) <= share / 100 or rest_s == 90.0
        assert rest_s == least_s or residue(rest_s - 1.0 - 1e-9) > share / 100


def test_a_residue_at_the_place_itself_is_that_of_the_material():
    context = example_plan([]).context
    load = Load("L0", 0.0, 0.0, 0.2, 0)
    assert predict_residue([load], [0.0], load, context) == pytest.approx(0.2 * 0.82)
    assert predict_residue([load], [25.4 * 3], load, context) == pytest.approx(0.2 * 0.62 * math.exp(-3), rel=1e-6)
    far = Load("L1", 40.0, 0.0, 0.2, 0)
    assert predict_residue([load], [5.0], far, context) < 0.002 * 0.2


def test_rests_by_residue_need_the_material():
    context = replace(example_plan([]).context, material=None)
    with pytest.raises(ConfigError, match="material's relaxation"):
        list(LocationGridSequence(residue_percent=1.0).steps(context))


def test_the_noise_figure_may_rest_until_the_sheet_is_stable_and_travel_low():
    steps = steps_of(NoiseFigureSequence(drift=0.25, least_rest_s=20.0, clearance_mm=2.0))
    assert steps[0] == LowerHover(2.0)
    assert [step for step in steps if isinstance(step, Settle)] == [Settle(240.0, True, 20.0, 0.25)]
