"""Recipes that characterise, the sequence they run, and the material files that come of them."""

import tomllib
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.app.run.preflight import check_cycles, check_recipe
from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type, load_station
from cbsr_qa.config.material import material_text
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.plan.plan import NO_RECONSTRUCTION, PhaseSpec
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, Role
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Relaxation
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.interfaces import SequenceContext
from cbsr_qa.station.limits import place_violations
from cbsr_qa.station.setup import plan_of
from cbsr_qa_plugins.sequences.characterisation import CharacterisationSequence

HEAD = '[recipe]\nname = "r"\ncalibrate_phases = []\n[[phases]]\nname = "p"\nsequence = "characterisation"\n'


@pytest.fixture
def refused(tmp_path):
    """Loads a recipe that must be refused, and returns why."""

    def why(text):
        path = tmp_path / "recipe.toml"
        path.write_text(text)
        with pytest.raises(ConfigError) as error:
            load_recipe(path)
        return error.value.reason

    return why


# --- recipe ---


def test_the_shipped_recipe_is_the_papers():
    recipe = load_recipe("characterisation").value
    assert recipe.characterisation == CharacterisationSettings()
    assert recipe.reconstruction is NO_RECONSTRUCTION
    (phase,) = recipe.phases
    assert phase.options["strains_percent"] == [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]
    assert (phase.options["cycles"], phase.options["hold_s"], phase.options["rest_s"]) == (10, 60.0, 60.0)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("", "reconstruction is missing; only a recipe with [characterisation] images nothing"),
        ('[characterisation]\n[reconstruction]\nmethod = "greit"', "reconstruction does not apply where"),
        ("[characterisation]\n[analysis]\nreference_frames = 3", "analysis does not apply where"),
        ("[characterisation]\n[metrics]\nnoise-figure = {}", "metrics does not apply where"),
        ("[characterisation]\ncontact_length_mm = 0.0", "characterisation.contact_length_mm"),
        ("[characterisation]\nsteady_frames = 4", "characterisation.steady_frames"),
    ],
)
def test_recipes_that_mix_two_ways_are_refused(refused, table, said):
    assert said in refused(HEAD + table)


def test_a_strip_has_nothing_to_calibrate(refused):
    said = refused(HEAD.replace("[]", '["p"]') + "[characterisation]")
    assert "recipe.calibrate_phases does not apply where [characterisation] is given" in said


def test_what_a_recipe_needs_is_known_before_anything_moves():
    recipe, plugins = load_recipe("characterisation").value, discover()
    strip = load_sensor_type("strip-40x20mm").value
    check_recipe(recipe, strip, plugins)
    with pytest.raises(NumericsError, match="recipe 'characterisation': sensor type 'disc-100mm' is not a strip"):
        check_recipe(recipe, load_sensor_type("disc-100mm").value, plugins)
    (wrong, *_) = recipe.limits
    with pytest.raises(ConfigError, match="no metric of this recipe measures 'gauge_factr'") as error:
        check_recipe(replace(recipe, limits=(replace(wrong, measurement="gauge_factr"),)), strip, plugins)
    assert "did you mean 'gauge_factor'?" in error.value.remedy
    with pytest.raises(ConfigError, match="is in 'kPa'; it is measured in '%'"):
        check_recipe(replace(recipe, limits=(replace(wrong, unit="kPa"),)), strip, plugins)
    with pytest.raises(NumericsError, match="0 independent readings"):
        check_recipe(load_recipe("nine-locations").value, strip, plugins)


@pytest.mark.parametrize(
    ("phases", "said"),
    [
        ([("grid", {"locations_mm": [[0.0, 0.0]]}, "location-grid")], "no phase of press cycles"),
        ([("a", {}, "characterisation"), ("b", {"x_mm": 0.5}, "characterisation")], "press cycles at 2 places"),
    ],
)
def test_a_recipe_without_cycles_in_one_place_is_refused(phases, said):
    recipe = load_recipe("characterisation").value
    recipe = replace(recipe, phases=tuple(PhaseSpec(name, sequence, options) for name, options, sequence in phases))
    station, plugins = load_station("simulated-strip").value, discover()
    strip, material = load_sensor_type("strip-40x20mm").value, load_material("cbsr-8wt").value
    plan = plan_of(Configuration(station, recipe, strip, material, 1, ""), plugins)
    with pytest.raises(ConfigError, match=said):
        check_cycles(plan, recipe)
    check_cycles(plan, load_recipe("nine-locations").value)  # no business of a recipe that images


@pytest.mark.parametrize(
    ("x_mm", "y_mm", "allowed"),
    [
        (0.0, 0.0, True),  # as wide as the strip, edge on edge
        (0.9, 0.0, True),  # along it
        (0.0, 0.1, False),  # over its side
        (0.0, -1e-6, False),
    ],
)
def test_a_head_with_corners_stands_where_all_of_its_outline_does(x_mm, y_mm, allowed):
    station, plugins = load_station("simulated-strip").value, discover()
    strip, material = load_sensor_type("strip-40x20mm").value, load_material("cbsr-8wt").value
    configuration = Configuration(station, load_recipe("characterisation").value, strip, material, 1, "")
    found = list(place_violations(x_mm, y_mm, plan_of(configuration, plugins)))
    assert not found if allowed else "mm from the sheet's edge" in found[0].what


# --- sequence ---


def steps(seed=0, **options):
    strip, head = load_sensor_type("strip-40x20mm").value, load_station("simulated-strip").value.indenter
    return list(CharacterisationSequence(**options).steps(SequenceContext(strip, head, seed)))


def test_cycles_are_pressed_strain_by_strain():
    found = steps(strains_percent=[10.0, 20.0], cycles=2, hold_s=30.0, rest_s=20.0, unloaded_frames=20)
    assert found[:4] == [FindSurface(0.0, 0.0), Hold(240.0, acquire=False), MarkUnloaded(), AcquireFrames(20)]
    loads = [step.load for step in found if isinstance(step, Press)]
    assert [(load.label, load.strain, load.trial) for load in loads] == [
        ("C1", 0.1, 0), ("C1", 0.1, 1), ("C2", 0.2, 0), ("C2", 0.2, 1),
    ]  # fmt: skip
    assert found[5:8] == [Hold(30.0, acquire=True), Release(), Hold(20.0, acquire=True)]
    assert CharacterisationSequence.role is Role.CHARACTERISATION


@pytest.mark.rest
@given(st.integers(0, 2**31 - 1))
def test_shuffled_strains_are_all_there_and_the_same_for_one_seed(seed):
    strains = [5.0, 10.0, 15.0, 20.0, 25.0, 30.0]
    options = {"strains_percent": strains, "cycles": 2, "order": "shuffled"}
    first, again = steps(seed, **options), steps(seed, **options)
    assert first == again
    pressed = [step.load for step in first if isinstance(step, Press)]
    assert sorted(load.strain for load in pressed) == sorted(2 * [s / 100 for s in strains])
    assert [load.strain for load in pressed[0::2]] == [load.strain for load in pressed[1::2]]
    assert all(strains[int(load.label[1:]) - 1] / 100 == load.strain for load in pressed)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"order": "random"}, "order is 'random'"),
        ({"cycles": 0}, "cycles is 0"),
        ({"strains_percent": [5.0, 5.0]}, "strains_percent is [5.0, 5.0]"),
        ({"strains_percent": [0.0]}, "strains_percent[1] is 0.0"),
        ({"unloaded_frames": 3}, "unloaded_frames is 3"),
        ({"rest_s": 0.0}, "rest_s is 0.0"),
        ({"trials": 3}, "trials is not a known key"),
    ],
)
def test_options_out_of_range_are_refused(options, said):
    with pytest.raises(ConfigError) as error:
        CharacterisationSequence(**options)
    assert said in error.value.reason


# --- material file ---

NUMBERS = st.floats(-1e6, 1e6)
ERRORS = st.none() | st.floats(0, 1e6)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1, max_size=40)
KERNELS = st.builds(
    lambda weights, tau, ratio, source: Relaxation(weights, (tau, ratio * tau), source),
    st.tuples(NUMBERS, NUMBERS), st.floats(1e-3, 1e3), st.floats(1.5, 1e3), TEXTS,
)  # fmt: skip


def _line(slope, intercept, correlation):
    known = None not in (slope.stderr, intercept.stderr, correlation)
    return QuasiStatic(slope, intercept, correlation * slope.stderr * intercept.stderr if known else None)


LINES = st.builds(_line, *2 * [st.builds(Parameter, NUMBERS, ERRORS, TEXTS)], st.none() | st.floats(-1, 1))


@given(st.builds(Parameter, st.floats(1e-6, 1e6), ERRORS, TEXTS), LINES, KERNELS, TEXTS)
def test_a_written_material_is_read_back_as_it_was(tmp_path_factory, parameter, line, kernel, name):
    material = replace(
        load_material("cbsr-8wt").value,
        name=name, modulus_kPa=parameter, against_stress=line, against_strain=line, loading_relaxation=kernel,
    )  # fmt: skip
    path = tmp_path_factory.mktemp("material") / "one.toml"
    path.write_text(material_text(material, ["a comment", ""]), encoding="utf-8")
    assert load_material(path).value == material


@pytest.mark.parametrize(
    ("errors", "covariance", "said"),
    [
        ((2e-4, 3e-3), 6.1e-7, "the product of the standard errors, 6e-07, is its largest size"),
        ((2e-4, 3e-3), -1.0, "covariance is -1"),
        ((0.0, 3e-3), 1e-9, "the product of the standard errors, 0,"),
        ((2e-4, None), 1e-9, "without the standard errors of slope and intercept"),
    ],
)
@pytest.mark.parametrize("line", ["against_stress", "against_strain"])
def test_a_covariance_that_no_line_can_have_is_refused(tmp_path, line, errors, covariance, said):
    fit = QuasiStatic(*(Parameter(0.5, error, "a test") for error in errors), covariance)
    material = replace(load_material("cbsr-8wt").value, **{line: fit})
    path = tmp_path / "one.toml"
    path.write_text(material_text(material), encoding="utf-8")
    with pytest.raises(ConfigError, match=f"material.{line}.covariance") as caught:
        load_material(path)
    assert said in str(caught.value)


def test_a_written_material_begins_with_its_comments():
    text = material_text(load_material("cbsr-9wt").value, ["first", "second"])
    assert text.startswith("# first\n# second\n\n[material]\n")
    assert tomllib.loads(text)["material"]["modulus_kPa"]["value"] == 98.1
