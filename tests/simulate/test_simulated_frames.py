"""Frames of the simulated world: what effects of each stage change, and readings taken one after the other."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_setting import HEAD, held, installed, pressed, scene, sensor_type, world
from tiers import rest_but

from cbsr_qa.domain.errors import ConfigError, NumericsError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.plan.world import HeadRing, Moment, SceneSetting, SheetDesign
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.simulate.sheet import SimulatedSheet

PATTERN = sensor_type().pattern


def effect(perturbs, change):
    """An effect class that does one thing at its stage."""

    class Plain:
        needs: tuple[str, ...] = ()

        def __init__(self, setting: SceneSetting) -> None:
            self.perturbs = perturbs

        def apply(self, moment):
            change(moment)

    class OfSheet:
        needs: tuple[str, ...] = ()

        def __init__(self, setting: SceneSetting) -> None:
            self.perturbs = perturbs

        def design(self, design):
            change(design)

    return OfSheet if perturbs == "sheet" else Plain


def world_with(perturbs, change, *names):
    extra = effect(perturbs, change)
    of = scene(*names)
    of = replace(of, effects=(*of.effects, PluginChoice("own")))
    return world(of, effect_factory=lambda name: extra if name == "own" else installed(name))


def in_turn(moment):
    """Readings in canonical order, all 256 within 2.4 s about the frame's time."""
    moment.reading_offsets_s = np.linspace(-1.2, 1.2, 256).reshape(16, 16)


def one_by_one(of, time_s):
    """Every reading from a frame taken at its own time."""
    offsets = np.linspace(-1.2, 1.2, 256)
    frames = [of.frame(time_s + offset, 0).voltages.ravel()[k] for k, offset in enumerate(offsets)]
    return np.array(frames).reshape(16, 16)


@pytest.mark.parametrize("time_s", rest_but({10.0, 0.6}, [10.0, 1.0, 61.3, 1.2, 61.2, 0.6]))
def test_readings_in_turn_are_those_of_frames_at_their_own_times(time_s):
    """While a load relaxes, while the head moves, and with a ramp that ends, begins or is half over in the middle."""
    names = ("piezoresistivity", "conductance-relaxation")
    skewed, plain = world_with("times", in_turn, *names), world(scene(*names))
    for each in (skewed, plain):
        each.presses.append(pressed(0, 12.0, -5.0, 0.2))
    found, expected = skewed.frame(time_s, 0), one_by_one(plain, time_s)
    change = np.abs(expected - plain.sheet.unloaded * plain.setting.current_A).max()
    assert np.abs(found.voltages - expected).max() < 2e-3 * change
    assert np.abs(plain.frame(time_s, 0).voltages - expected).max() > 1e-2 * change
    assert np.array_equal(found.time_s, time_s + np.linspace(-1.2, 1.2, 256).reshape(16, 16))


@pytest.mark.parametrize(("frames", "most"), [(8, 4e-3), (24, 2e-4), (480, 1e-6)])
def test_a_swing_is_followed_to_what_a_parabola_leaves_of_a_sine(frames, most):
    """(π T/P)³/9√3 of a swing with the period P, in the worst phase, over the 2.4 s of a frame."""
    assert (np.pi * 2.4 / (2.5 * frames)) ** 3 / (9 * np.sqrt(3)) < most
    swing = {"coefficient_per_K": 1e-3, "swing_K": 1.0, "period_s": 2.5 * frames}
    extra, of = effect("times", in_turn), scene("temperature-drift", temperature_drift=swing)
    of = replace(of, effects=(*of.effects, PluginChoice("own")))
    swinging = world(of, effect_factory=lambda name: extra if name == "own" else installed(name))
    cold = swinging.sheet.unloaded * swinging.setting.current_A
    for time_s in (100.0, 103.0, 110.0):
        frame = swinging.frame(time_s, 0)
        warmer = 1e-3 * np.sin(2 * np.pi * frame.time_s / (2.5 * frames))
        assert np.abs(frame.voltages / cold - 1 / (1 + warmer)).max() < 1e-3 * most


def test_readings_in_turn_of_a_sheet_at_rest_are_those_at_once():
    skewed, plain = world_with("times", in_turn), world(scene())
    assert np.array_equal(skewed.frame(5.0, 0).voltages, plain.frame(5.0, 0).voltages)
    assert plain.frame(5.0, 0).time_s is None


def test_contacts_that_drift_are_solved_for():
    def worse(moment):
        moment.contact_mm = moment.contact_mm * np.linspace(1, 3, 16) * (1 + moment.time_s)

    drifting = world_with("contacts", worse)
    contacts = 0.2 * np.linspace(1, 3, 16) * 8.0
    model = drifting.sheet.unit_model.with_values(contact_impedance=contacts)
    expected = model.voltages() / drifting.sheet.conductance_S * drifting.setting.current_A
    assert drifting.frame(7.0, 0).voltages == pytest.approx(expected, rel=1e-8, abs=1e-12)


def test_the_source_sees_the_driven_pairs_and_scales_its_rows():
    seen = {}

    def limited(moment):
        seen["ohm"] = moment.drive_ohm.copy()
        moment.current_A = np.where(np.arange(16) == 3, 0.25, 1.0)[:, None] * moment.current_A
        moment.flags[3] |= np.uint8(ReadingFlag.COMPLIANCE)

    weak, plain = world_with("source", limited), world(scene())
    found, whole = weak.frame(5.0, 0), plain.frame(5.0, 0)
    assert found.voltages[3] == pytest.approx(0.25 * whole.voltages[3])
    assert np.array_equal(np.delete(found.voltages, 3, 0), np.delete(whole.voltages, 3, 0))
    assert (found.flags == np.where(np.arange(16) == 3, ReadingFlag.COMPLIANCE, 0)[:, None]).all()
    assert seen["ohm"] == pytest.approx(np.tile(np.diag(whole.voltages)[:, None] / plain.setting.current_A, 16))


def test_uneven_sheets_are_forward_models_with_those_conductances():
    def uneven(design):
        design.conductance.append(lambda places: 1 + 0.004 * places[:, 0])
        design.thickness.append(lambda places: 1 - 0.003 * places[:, 1])

    sheet = world_with("sheet", uneven).sheet
    x, y = sheet.mesh.centroids_mm.T
    model = ForwardModel(sheet.mesh, PATTERN, (1 + 0.004 * x) * (1 - 0.003 * y), np.full(16, 0.2), order=2)
    assert sheet.unloaded * sheet.conductance_S == pytest.approx(model.voltages(), rel=1e-12)


def test_response_by_place_scales_the_change_there():
    def lively(design):
        design.response.append(lambda places: np.where(places[:, 0] > 0, 2.0, 0.5))

    sheet, even = world_with("sheet", lively).sheet, world(scene()).sheet
    for x, factor in ((20.0, 2.0), (-20.0, 0.5)):
        found = sheet.voltages({(x, 0.0): 0.1})
        assert found == pytest.approx(even.voltages({(x, 0.0): 0.1 * factor}), rel=1e-12)


def test_rings_of_pressure_add_up():
    """A head in two rings of half the weight is the mean of the two heads, for a change small enough to be linear."""
    rings = (HeadRing(1.2, 0.5), HeadRing(0.8, 0.5))
    design = SheetDesign.make_uniform(sensor_type(), HEAD)
    design.rings = rings
    soft = SimulatedSheet(design, size_mm=5.0, interelectrode_resistance_ohm=1e4)
    place = {(14.0, 3.0): 1e-4}
    parts = []
    for ring in rings:
        plain = SheetDesign.make_uniform(sensor_type(), HEAD.scale(ring.size))
        one = SimulatedSheet(plain, size_mm=5.0, interelectrode_resistance_ohm=1e4)
        parts.append(one.voltages(place) - one.unloaded)
    found = soft.voltages(place) - soft.unloaded
    assert found == pytest.approx(np.mean(parts, axis=0), abs=1e-4 * np.abs(found).max())


def test_electrodes_out_of_place_are_where_they_were_put():
    def bump(design):
        design.shift_mm[5] += (0.4, -0.3)

    sheet = world_with("sheet", bump).sheet
    nominal = sensor_type().electrodes.positions_mm()
    rims = [sheet.mesh.nodes_mm[np.unique(edges)].mean(axis=0) for edges in sheet.mesh.electrode_edges]
    assert np.array(rims) - nominal == pytest.approx(
        np.where(np.arange(16) == 5, 1, 0)[:, None] * [0.4, -0.3], abs=0.01
    )


def test_electrodes_on_top_of_each_other_or_off_the_sheet_are_refused():
    def onto(design):
        design.shift_mm[5] = sensor_type().electrodes.positions_mm()[6] - sensor_type().electrodes.positions_mm()[5]

    def off(design):
        design.shift_mm[0] = (3.0, 0.0)

    for change in (onto, off):
        with pytest.raises((RefusedError, NumericsError, ConfigError), match="electrode"):
            world_with("sheet", change)


@pytest.mark.parametrize(("claims", "made_for"), [("sheet", "geometry"), ("geometry", "sheet")])
def test_an_effect_that_lacks_the_method_of_its_stage_is_refused(claims, made_for):
    class Wrong(effect(made_for, id)):
        def __init__(self, setting):
            self.perturbs = claims

    of = replace(scene(), effects=(PluginChoice("own"),))
    with pytest.raises(ConfigError, match=f"perturbs '{claims}' but lacks the method"):
        world(of, effect_factory=lambda _: Wrong)


# --- what is over ---


def test_forgotten_presses_change_no_reading_that_anybody_could_see():
    effects = ("piezoresistivity", "conductance-relaxation", "residue")
    one = world(scene(*effects, residue={"share": 0.1, "decay_s": 20.0}))
    other = world(scene(*effects, residue={"share": 0.1, "decay_s": 20.0}), seed=1)
    one.presses += [pressed(0, 5.0, 5.0, 0.3), pressed(1, -20.0, 0.0, 0.2, start_s=3000.0)]
    other.presses += one.presses[1:]
    assert one.chain.memory_s < 1000
    np.testing.assert_array_equal(one.voltages_V(3020.0, 3), other.voltages_V(3020.0, 3))
    assert np.abs(one.voltages_V(100.0, 3) - other.voltages_V(100.0, 3)).max() > 1e-6


def test_a_press_in_a_boards_pause_is_felt_by_the_rows_after_it():
    """However long the pause is: rows see the presses of their own time."""
    skewed, plain = world_with("times", in_turn, "piezoresistivity"), world(scene("piezoresistivity"))
    late = np.where(np.arange(16) < 9, 0.0, 20.0)
    for each in (skewed, plain):
        each.presses.append(pressed(0, 12.0, -5.0, 0.2, start_s=15.0))
    found, unloaded = skewed.frame(0.0, 0, late).voltages, plain.frame(0.0, 0).voltages
    np.testing.assert_allclose(found[:9], unloaded[:9], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found[9:], plain.frame(20.0, 0).voltages[9:], rtol=1e-9, atol=1e-12)


def test_a_press_that_is_held_is_never_forgotten():
    one = world(scene("piezoresistivity"))
    unloaded = one.voltages_V(0.0, 0)
    one.presses.append(held(0, 5.0, 5.0, 0.3))
    assert one.chain.memory_s == 0
    np.testing.assert_array_equal(one.voltages_V(100.0, 0), one.voltages_V(1e6, 0))
    assert np.abs(one.voltages_V(1e6, 0) - unloaded).max() > 1e-4


def test_an_effect_that_does_not_say_how_long_it_remembers_remembers_for_ever():
    class Silent:
        needs, perturbs = (), "response"

        def __init__(self, setting: SceneSetting) -> None:
            del setting

        def apply(self, moment: Moment) -> None:
            moment.response = [change + 0.01 for change in moment.response]

    one = world(scene("silent"), effect_factory=lambda name: Silent)
    one.presses.append(pressed(0, 5.0, 5.0, 0.3))
    assert one.chain.memory_s == np.inf
    unloaded = world(scene()).voltages_V(1e6, 0)
    assert np.abs(one.voltages_V(1e6, 0) - unloaded).max() > 1e-5


# --- the sheet's edge ---


def test_only_what_lies_on_the_sheet_is_pressed():
    """A head with its axis on a round sheet's edge, between two pins: two circles' lens, of radii 6.5 and 50 mm."""
    one, between = world(scene("elastic-stress")), np.pi / 16
    one.presses.append(held(0, 50.0 * np.cos(between), 50.0 * np.sin(between), 0.2))
    inside = world(scene("elastic-stress"))
    inside.presses.append(held(0, 43.0, 0.0, 0.2))
    r, R = 6.5, 50.0
    lens = r**2 * np.arccos(r / (2 * R)) + R**2 * np.arccos(1 - r**2 / (2 * R**2))
    lens -= 0.5 * np.sqrt((2 * R - r) * r * r * (2 * R + r))
    assert inside.force_N(10.0, 0) == pytest.approx(132.5 * 0.2 * np.pi * r**2 * 1e-3)
    assert one.force_N(10.0, 0) / inside.force_N(10.0, 0) == pytest.approx(lens / (np.pi * r**2), rel=2e-3)


def test_a_mesh_that_nobody_waits_for_is_refused():
    with pytest.raises(ConfigError, match=r"sheet_mesh_size_mm is 0\.01") as said:
        world(replace(scene(), sheet_mesh_size_mm=0.01))
    assert "at least 1" in said.value.remedy
