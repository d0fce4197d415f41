"""A scene becomes a chain of effects over a sheet; what is off is not there."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from simulated_setting import HEAD, base_scene, held, installed, material, pressed, scene, sensor_type, truth, world

from cbsr_qa.domain.errors import ConfigError, NumericsError, PluginError, RefusedError
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.plan.world import CONTACT_LENGTH_MM, Moment, SceneSetting, SheetDesign
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.simulate.chain import build_chain
from cbsr_qa.simulate.frames import NEGLIGIBLE_CHANGE
from cbsr_qa.simulate.sheet import SimulatedSheet

SETTING = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)


def _effect(perturbs: str, *, needs: tuple[str, ...] = (), write: float = 0.0):
    class Written:
        def __init__(self, setting: SceneSetting) -> None:
            self.needs, self.perturbs = needs, perturbs

        def apply(self, moment: Moment) -> None:
            moment.force_N = 10 * moment.force_N + write

    return Written


def _build(made: dict, *names: str):
    return build_chain(scene(*names), SETTING, made.__getitem__)


# --- the chain ---


def test_effects_of_a_stage_are_applied_in_the_scenes_order():
    made = {"one": _effect("force", write=1), "two": _effect("force", write=2), "other": _effect("stress", write=9)}
    for names, expected in ((("one", "other", "two"), 12.0), (("two", "one", "other"), 21.0)):
        moment = Moment(SETTING, 0.0, 0, [], [], [])
        _build(made, *names).apply("force", moment)
        assert moment.force_N == expected


def test_only_the_effects_that_are_on_are_asked_for():
    asked = []

    def factory(name: str):
        asked.append(name)
        return _effect("force")

    build_chain(scene("one", "two"), SETTING, factory)
    assert asked == ["one", "two"]


@pytest.mark.rest
def test_modules_of_effects_that_are_off_are_not_imported():
    code = (
        "import sys; sys.path.insert(0, 'tests/samples')\n"
        "from simulated_setting import installed, scene, world\n"
        "world(scene('piezoresistivity', 'measurement-noise'))\n"
        "print(*sorted(m for m in sys.modules if m.startswith('cbsr_qa_plugins.effects.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["cbsr_qa_plugins.effects.readings", "cbsr_qa_plugins.effects.sheet"]


@pytest.mark.parametrize(
    ("effects", "refusal", "named"),
    [
        (("conductance-relaxation",), ConfigError, "'conductance-relaxation' without 'piezoresistivity'"),
        (("stress-relaxation", "elastic-stress"), ConfigError, "'stress-relaxation' before 'elastic-stress'"),
        (("piezoresistivity", "piezoresistivity"), ConfigError, "twice"),
        (("load-cell-noise",), ConfigError, "rms_N is missing"),
        (("piezoresistance",), PluginError, "piezoresistance"),
    ],
)
def test_effects_that_make_no_scene_are_refused_by_name(effects, refusal, named):
    with pytest.raises(refusal, match=named) as refused:
        build_chain(scene(*effects), SETTING, installed)
    assert refused.value.remedy


def test_an_effect_that_perturbs_nothing_known_is_refused():
    with pytest.raises(ConfigError, match="perturbs 'mood'"):
        _build({"odd": _effect("mood")}, "odd")


# --- the sheet ---


def _physical_model(of: SimulatedSheet) -> ForwardModel:
    """The same sheet in ohms and siemens, factorised afresh."""
    conductance = np.full(len(of.mesh.elements), of.conductance_S)
    impedance = np.full(16, CONTACT_LENGTH_MM / of.conductance_S)
    return ForwardModel(of.mesh, sensor_type().pattern, conductance, impedance, order=2)


def test_without_effects_voltages_are_the_forward_models():
    silent = world(scene())
    silent.presses.append(held(0, 0.0, 0.0, 0.2))
    expected = _physical_model(silent.sheet).voltages() * silent.setting.current_A
    np.testing.assert_allclose(silent.voltages_V(30.0, 12), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["cbsr-8wt", "cbsr-9wt"])
def test_the_mean_driven_pair_has_the_materials_resistance(name: str):
    resistance = material(name).interelectrode_resistance_ohm.value
    sheet = SimulatedSheet(
        SheetDesign.make_uniform(sensor_type(), HEAD), size_mm=5.0, interelectrode_resistance_ohm=resistance
    )
    assert np.diag(sheet.unloaded).mean() == pytest.approx(resistance, rel=1e-12)


def test_the_contact_share_is_the_slope_of_the_resistance_in_the_contact_impedance():
    sheet = SimulatedSheet(
        SheetDesign.make_uniform(sensor_type(), HEAD), size_mm=5.0, interelectrode_resistance_ohm=1e3
    )
    step = 1e-4

    def log_resistance(factor: float) -> float:
        contacts = np.full(16, CONTACT_LENGTH_MM * factor)
        model = ForwardModel(sheet.mesh, sensor_type().pattern, np.ones(len(sheet.mesh.elements)), contacts, order=2)
        return float(np.log(np.diag(model.voltages()).mean()))

    slope = (log_resistance(1 + step) - log_resistance(1 - step)) / (2 * step)
    assert sheet.contact_share == pytest.approx(slope, rel=1e-5)
    assert 0.08 < sheet.contact_share < 0.12  # what the documentation says


def test_loaded_voltages_equal_a_model_factorised_afresh():
    loaded = world(scene("piezoresistivity"))
    loaded.presses += [held(0, 3.0, -2.0, 0.3), held(1, 30.0, 1.0, 0.1)]
    model = _physical_model(loaded.sheet)
    covers = [cover(model.elements, HEAD.footprint_at(press.x_mm, press.y_mm)) for press in loaded.presses]
    strains = [press.strain_at(30.0) for press in loaded.presses]
    changes = [one.change(model.conductance, 0.6 * strain) for one, strain in zip(covers, strains, strict=True)]
    elements = np.concatenate([one.elements for one in covers])
    expected = model.with_change_on(elements, np.concatenate(changes)).voltages() * loaded.setting.current_A
    mean = np.abs(expected[sensor_type().pattern.usable()]).mean()
    np.testing.assert_allclose(loaded.voltages_V(30.0, 12), expected, rtol=0, atol=1e-8 * mean)


def test_presses_at_one_place_act_as_one():
    split, whole = world(scene("piezoresistivity")), world(scene("piezoresistivity"))
    split.presses += [held(0, 10.0, 5.0, 0.05), held(1, 10.0, 5.0, 0.15)]
    whole.presses.append(held(0, 10.0, 5.0, 0.2))
    one, other = split.voltages_V(9.0, 0), whole.voltages_V(9.0, 0)
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-13 * np.abs(other).max())


def test_what_is_left_out_as_negligible_is_far_below_the_noise():
    sheet = world(scene()).sheet
    used = sensor_type().pattern.usable()
    worst = max(
        np.abs(sheet.voltages({place: NEGLIGIBLE_CHANGE}) - sheet.unloaded)[used].max()
        for place in ((0.0, 0.0), (30.0, 0.0), (28.0, 28.0), (42.0, 0.0))
    )
    assert 0 < worst / np.abs(sheet.unloaded[used]).mean() < 1e-3 * material("cbsr-9wt").relative_noise.value


def test_a_faded_press_leaves_the_sheet_unloaded_bit_for_bit():
    faded = world(scene("piezoresistivity", "conductance-relaxation"))
    faded.presses.append(pressed(0, 0.0, 0.0, 0.2))
    unloaded = faded.sheet.unloaded * faded.setting.current_A
    assert np.abs(faded.voltages_V(120.0, 0) - unloaded).max() > 0
    np.testing.assert_array_equal(faded.voltages_V(1000.0, 0), unloaded)


def test_a_head_outside_the_sheet_is_refused():
    outside = world(scene("piezoresistivity"))
    outside.presses.append(held(0, 60.0, 0.0, 0.2))
    with pytest.raises(RefusedError, match="outside the sheet"):
        outside.voltages_V(9.0, 0)


def test_a_change_that_leaves_no_conductance_is_refused():
    sheet = world(scene()).sheet
    with pytest.raises(NumericsError, match="conductance"):
        sheet.voltages({(0.0, 0.0): -1.5})


# --- the world ---


def test_moments_can_be_asked_for_in_any_order():
    here = world(base_scene())
    here.presses += [pressed(0, 0.0, 0.0, 0.2), pressed(1, 20.0, 0.0, 0.1, start_s=130.0)]
    times = (10.0, 70.0, 140.0, 200.0)
    forward = [here.voltages_V(time_s, int(time_s)) for time_s in times]
    backward = [here.voltages_V(time_s, int(time_s)) for time_s in reversed(times)]
    for one, other in zip(forward, reversed(backward), strict=True):
        np.testing.assert_array_equal(one, other)


def test_another_effect_changes_no_numbers_of_the_others():
    class Hum:
        needs, perturbs = (), "voltages"

        def __init__(self, setting: SceneSetting) -> None:
            self._draw = np.random.default_rng(setting.seed)

        def apply(self, moment: Moment) -> None:
            self._draw.standard_normal(7)

    plain = base_scene()
    more = replace(plain, effects=(PluginChoice("hum"), *plain.effects))
    one = world(plain)
    other = world(more, effect_factory=lambda name: Hum if name == "hum" else installed(name))
    for each in (one, other):
        each.presses.append(held(0, 5.0, 5.0, 0.2))
    for index in (3, 40):
        np.testing.assert_array_equal(one.voltages_V(2.5 * index, index), other.voltages_V(2.5 * index, index))
        assert one.force_N(2.5 * index, index) == other.force_N(2.5 * index, index)


def test_the_truth_of_a_held_press_is_the_quasi_static_line():
    here = world(base_scene())
    here.presses.append(held(0, 7.0, 0.0, 0.2))
    (true,) = truth(here, 2000.0)
    assert true.strain == pytest.approx(0.2)
    assert true.relative_change == pytest.approx(0.12)
    assert true.stress_kPa == pytest.approx(26.5)


def test_a_lifted_head_reads_no_force_though_the_sheet_still_relaxes():
    here = world(scene("elastic-stress", "stress-relaxation"))
    here.presses.append(pressed(0, 0.0, 0.0, 0.2))
    assert here.force_N(50.0, 0) > 3.0
    assert here.force_N(62.5, 0) == 0.0
    assert truth(here, 62.5)[0].stress_kPa == 0.0
