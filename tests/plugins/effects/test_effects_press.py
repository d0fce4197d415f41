"""Effects on what a press does, and on the head and cell that press: each against its closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest
from effect_setting import STEP_S, applied, history, moment, setting, world_of
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa_plugins.effects.force import (
    Confinement,
    ElasticStress,
    LoadCellSaturation,
    StressRelaxation,
)
from cbsr_qa_plugins.effects.head import ApplicatorPositionError, Backlash, HeadEdge, MisplacedSheet, PressureProfile
from cbsr_qa_plugins.effects.sheet import (
    ConductanceRelaxation,
    Hysteresis,
    Piezoresistivity,
    Residue,
    TemperatureDrift,
    UnloadingSpike,
)

OF = setting()
GAUGE = 0.6  # of the 8 wt% material
PRESS = history((0.0, STEP_S, 0.2), (60.0, STEP_S, -0.2))


def response(effect, time_s, press=PRESS):
    return applied(effect, moment(OF, time_s, press)).response[0]


def test_a_spike_goes_the_other_way_and_fades():
    """The change is 0.12 while held; at its release it stands 30 % above that, and joins the material's own curve."""
    spike, slow = UnloadingSpike(OF, size=0.3, decay_s=0.8), ConductanceRelaxation(OF)
    quasi = Piezoresistivity(OF)

    def change(time_s):
        return sum(response(effect, time_s) for effect in (quasi, slow, spike))

    assert response(spike, 59.9) == 0
    assert change(60.0 + 2 * STEP_S) - change(60.0 - STEP_S) == pytest.approx(0.3 * GAUGE * 0.2, rel=1e-4)
    start = response(spike, 60.0 + 2 * STEP_S)
    for after_s in (0.5, 2.0, 8.0):
        assert response(spike, 60.0 + after_s) == pytest.approx(start * math.exp(-after_s / 0.8), rel=1e-5)


def test_a_residue_is_a_share_that_fades():
    residue = Residue(OF, share=0.05, decay_s=300.0)
    assert response(residue, 59.0) == 0
    for after_s in (1.0, 100.0, 900.0):
        assert response(residue, 60 + after_s) == pytest.approx(
            0.05 * GAUGE * 0.2 * math.exp(-after_s / 300), rel=1e-6
        )


def test_the_way_back_is_a_parabola_above_the_way_there():
    triangle = history((0.0, 10.0, 0.2), (20.0, 10.0, -0.2))
    loop = Hysteresis(OF, width=0.1)
    for time_s in (0.0, 3.0, 10.0, 15.0, 20.0):
        assert response(loop, time_s, triangle) == pytest.approx(0, abs=1e-15)
    for time_s in (22.0, 25.0, 28.0):
        share = triangle.strain_at(time_s) / 0.2
        assert response(loop, time_s, triangle) == pytest.approx(4 * 0.1 * GAUGE * 0.2 * share * (1 - share))
    assert response(loop, 25.0, triangle) == pytest.approx(0.1 * GAUGE * 0.2)
    assert response(loop, 31.0, triangle) == pytest.approx(0, abs=1e-15)


def test_pressing_again_to_the_same_depth_stays_on_the_way_back():
    twice = history((0.0, 1.0, 0.2), (10.0, 1.0, -0.1), (20.0, 1.0, 0.1), (30.0, 1.0, 0.1))
    loop = Hysteresis(OF, width=0.1)
    back, again = response(loop, 10.5, twice), response(loop, 20.5, twice)
    assert back == pytest.approx(again)
    assert back > 0
    assert response(loop, 30.5, twice) == pytest.approx(0, abs=1e-12)  # deeper than ever: the way there


@given(width=st.floats(0, 10))
def test_a_soft_edge_keeps_what_presses_in_all(width):
    design = SheetDesign.make_uniform(OF.sensor_type, OF.indenter)
    HeadEdge(OF, width_mm=width).design(design)
    assert sum(ring.weight * ring.size**2 for ring in design.rings) == pytest.approx(1)
    sizes = [ring.size for ring in design.rings]
    assert max(sizes) - 1 == pytest.approx(1 - min(sizes))
    assert max(sizes) - min(sizes) == pytest.approx(width / 6.5 * 7 / 8)


@pytest.mark.parametrize(
    ("shape", "pressure"),
    [("punch", lambda rho: 0.5 / math.sqrt(1 - rho**2)), ("parabola", lambda rho: 2 * (1 - rho**2))],
)
def test_a_profile_is_its_pressure_in_annuli(shape, pressure):
    design = SheetDesign.make_uniform(OF.sensor_type, OF.indenter)
    PressureProfile(OF, shape=shape).design(design)
    assert sum(ring.weight * ring.size**2 for ring in design.rings) == pytest.approx(1)
    for rho in (0.25, 0.45, 0.65):
        found = sum(ring.weight for ring in design.rings if ring.size > rho)
        assert found == pytest.approx(pressure(rho), rel=0.02)


def test_edges_and_profiles_combine():
    design = SheetDesign.make_uniform(OF.sensor_type, OF.indenter)
    PressureProfile(OF, shape="parabola").design(design)
    HeadEdge(OF, width_mm=1.0).design(design)
    assert len(design.rings) == 80
    assert sum(ring.weight * ring.size**2 for ring in design.rings) == pytest.approx(1)


@pytest.mark.parametrize(
    "make", [lambda of: HeadEdge(of, width_mm=1.0), lambda of: PressureProfile(of, shape="punch")]
)
def test_a_head_whose_smaller_outlines_leave_it_is_refused(make):
    """What presses in all would depend on the mesh, and be less by a fifth at the sheet's edge."""
    round_about = [(-6, -6), (6, -6), (6, 0), (0, 0), (0, 6), (-6, 6)]  # the axis in its inner corner
    for corners, good in (
        (round_about, True),
        ([(x + 1, y - 1) for x, y in round_about], False),
        ([(-8, 0), (8, 0), (8, 5), (-8, 5)], True),
        ([(-8, 2), (8, 2), (8, 5), (-8, 5)], False),
    ):
        head = Indenter.with_outline(corners)
        if good:
            design = SheetDesign.make_uniform(OF.sensor_type, head)
            make(replace(OF, indenter=head)).design(design)
            assert sum(ring.weight * ring.size**2 for ring in design.rings) == pytest.approx(1)
        else:
            with pytest.raises(ConfigError, match="seen from behind by its axis"):
                make(replace(OF, indenter=head))


def test_a_confined_layer_is_stiffer_relaxation_and_all():
    plain, confined = (moment(OF, 5.0, history((0.0, 1.0, 0.2))) for _ in range(2))
    for at in (plain, confined):
        ElasticStress(OF).apply(at)
        StressRelaxation(OF).apply(at)
    Confinement(OF).apply(confined)
    assert confined.stress_kPa[0] / plain.stress_kPa[0] == pytest.approx(1 + 2 * (6.5 / 8) ** 2)
    assert confined.stress_kPa[0] / plain.stress_kPa[0] == pytest.approx(2.3, abs=0.03)


def test_warmth_scales_what_electrodes_see():
    drift = TemperatureDrift(OF, coefficient_per_K=0.01, rate_K_per_h=2.0, swing_K=0.5, period_s=600.0)
    for time_s in (0.0, 150.0, 3600.0):
        at = applied(drift, moment(OF, time_s), impedance_ohm=np.eye(16))
        warmer = 2 * time_s / 3600 + 0.5 * math.sin(2 * math.pi * time_s / 600)
        assert at.impedance_ohm[3, 3] == pytest.approx(1 / (1 + 0.01 * warmer))


@pytest.mark.parametrize(("force_N", "read_N"), [(3.0, 3.0), (9.0, 7.35), (-9.0, -7.35)])
def test_a_cell_reads_its_limit_beyond_it(force_N, read_N):
    assert applied(LoadCellSaturation(OF, limit_N=7.35), moment(OF, 0.0), force_N=force_N).force_N == read_N


def test_the_head_is_off_as_stated_and_differently_each_time():
    effect, found = ApplicatorPositionError(OF, error_mm=0.2, depth_error_mm=0.01), []
    for index in range(2000):
        at = applied(effect, moment(OF, 0.0, index=index), place_mm=(10.0, -5.0), depth_mm=0.8)
        found.append((*at.place_mm, at.depth_mm))
    assert np.mean(found, axis=0) == pytest.approx([10, -5, 0.8], abs=0.02)
    assert np.std(found, axis=0) == pytest.approx([0.2, 0.2, 0.01], rel=0.08)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-180, 180))
def test_a_misplaced_sheet_moves_all_places_by_one_motion(x_mm, y_mm, rotation_deg):
    """What lies at the sheet's centre is where the station calls (3, −2); distances stay."""
    effect = MisplacedSheet(OF, x_mm=3.0, y_mm=-2.0, rotation_deg=rotation_deg)
    found = []
    for told in ((3.0, -2.0), (x_mm, y_mm), (x_mm + 1.0, y_mm)):
        at = applied(effect, moment(OF, 0.0), place_mm=told, depth_mm=0.8)
        assert at.depth_mm == 0.8
        found.append(complex(*at.place_mm))
    assert abs(found[0]) < 1e-12
    assert abs(found[1]) == pytest.approx(math.hypot(x_mm - 3.0, y_mm + 2.0), abs=1e-9)
    along = found[2] - found[1]
    assert along == pytest.approx(
        complex(math.cos(math.radians(rotation_deg)), -math.sin(math.radians(rotation_deg)))
    )


def test_an_axis_stops_short_on_the_side_it_came_from():
    at = moment(OF, 0.0)
    at.from_mm, at.place_mm, at.from_depth_mm, at.depth_mm = (0.0, 5.0), (15.0, 5.0), 0.8, -25.0
    Backlash(OF, play_mm=0.1, depth_play_mm=0.04).apply(at)
    assert at.place_mm == (pytest.approx(14.95), 5.0)
    assert at.depth_mm == pytest.approx(-24.98)


@pytest.mark.rest
@given(st.lists(st.floats(-3, 3), min_size=1, max_size=12), st.floats(0, 1))
def test_play_is_used_up_before_an_axis_follows(told, play):
    """It is never further off than half of its play, never moves away from where it is told, and may stay."""
    effect, here = Backlash(OF, play_mm=0.1, depth_play_mm=play), 0.0
    for depth in told:
        at = applied(effect, moment(OF, 0.0), from_depth_mm=here, depth_mm=depth)
        assert abs(at.depth_mm - depth) <= play / 2 + 1e-12
        assert abs(at.depth_mm - depth) <= max(abs(here - depth), 0.0)
        if abs(here - depth) <= play / 2:
            assert at.depth_mm == here
        here = at.depth_mm


def test_what_acts_on_others_comes_after_those_that_are_on():
    elastic, relaxing, confined = ((name, {}) for name in ("elastic-stress", "stress-relaxation", "confinement"))
    world_of(elastic, confined)
    world_of(elastic, relaxing, confined)
    with pytest.raises(ConfigError, match="'confinement' before 'stress-relaxation', which it acts on") as caught:
        world_of(elastic, confined, relaxing)
    assert "move 'stress-relaxation' above 'confinement'" in caught.value.remedy
    with pytest.raises(ConfigError, match="before 'load-cell-noise'"):
        world_of(("load-cell-saturation", {"limit_N": 7.0}), ("load-cell-noise", {"rms_N": 0.1}))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: UnloadingSpike(OF, size=3.0, decay_s=1.0), "from 0 to 2"),
        (lambda: Residue(OF, share=1.5, decay_s=300.0), "share is 1.5"),
        (lambda: Hysteresis(OF, width=0.9), "width is 0.9"),
        (lambda: HeadEdge(OF, width_mm=20.0), "width_mm is 20"),
        (lambda: PressureProfile(OF, shape="flat"), "'punch' or 'parabola'"),
        (lambda: Confinement(OF, factor=0.0), "factor is 0"),
        (lambda: TemperatureDrift(OF, coefficient_per_K=1.0), "coefficient_per_K is 1"),
        (lambda: Backlash(OF, play_mm=6.0), "play_mm is 6"),
    ],
)
def test_parameters_that_make_no_sense_are_named(made, said):
    with pytest.raises(ConfigError, match=said):
        made()


def test_a_temperature_that_leaves_no_conductance_is_refused():
    drift = TemperatureDrift(OF, coefficient_per_K=-0.05, rate_K_per_h=20.0)
    with pytest.raises(RefusedError, match="no conductance at 7200 s"):
        applied(drift, moment(OF, 7200.0), impedance_ohm=np.eye(16))
