"""Failure codes of a recipe: which limits and rules have one, and what is refused."""

import json

import pytest

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type, load_station
from cbsr_qa.config.merging import merge, restore
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.limits import FailureCode


@pytest.fixture
def recipe(tmp_path):
    """Return how to load the shipped recipe with other failure codes."""
    shipped, _ = open_document(DocumentKind.RECIPE, "nine-locations").text.split("[failure_codes]")

    def load(codes):
        (tmp_path / "own.toml").write_text(f"{shipped}[failure_codes]\n{codes}\n")
        return load_recipe(tmp_path / "own.toml")

    return load


@pytest.mark.parametrize("name", ["nine-locations", "adaptive", "adaptive-batch"])
def test_every_limit_of_a_shipped_recipe_has_a_code_with_a_disposition(name):
    loaded = load_recipe(name).value
    coded = {cause for code in loaded.failure_codes for cause in code.causes}
    assert {limit.measurement for limit in loaded.limits} | {"not measured", "aborted", "broken"} == coded
    assert all(code.text and code.disposition for code in loaded.failure_codes)


def test_a_code_of_several_limits_is_one_code(recipe):
    noisy = '{ code = "N1", text = "noisy", disposition = "check plug" }'
    (code,) = recipe(f'noise_floor = {noisy}\n"drift" = {noisy}').value.failure_codes
    assert code == FailureCode("N1", "noisy", "check plug", ("drift", "noise_floor"))
    assert (str(code), code.words) == ("N1", "N1 noisy: check plug")


def test_a_limit_is_named_with_its_phase_and_qualifier_or_without(recipe):
    names = [
        "centre_of_mass_error",
        "centre_of_mass_error (random loads)",
        "channel_snr (worst)",
        "drift (relaxation)",
        "retest",
    ]
    codes = "\n".join(f'"{name}" = {{ code = "C{k}", text = "t" }}' for k, name in enumerate(names))
    assert [code.causes for code in recipe(codes).value.failure_codes] == [(name,) for name in sorted(names)]


def test_codes_are_stored_with_the_run(recipe):
    loaded = recipe('drift = { code = "D", text = "drifts", disposition = "scrap" }')
    stored = merge(
        load_station("simulated"), loaded, load_sensor_type("disc-100mm"), load_material("cbsr-8wt"), seed=1
    )
    assert restore(stored.canonical).recipe.failure_codes == loaded.value.failure_codes
    assert json.loads(stored.canonical)["recipe"]["failure_codes"]["drift"]["code"] == "D"


@pytest.mark.parametrize(
    ("codes", "said"),
    [
        ('drif = { code = "D", text = "t" }', ("failure_codes.drif ", "did you mean 'drift'", "not measured")),
        ('"drift (no phase)" = { code = "D", text = "t" }', ("drift (no phase)", "is no limit of this recipe")),
        ('"area_overlap (random loads)" = { code = "D", text = "t" }', ("area_overlap (nine locations)",)),
        ('drift = { code = "D", text = "" }', ("failure_codes.drift.text is ''", "1 to 200 characters")),
        ('drift = { code = "D", text = " t" }', ("text is ' t'", "without a blank")),
        ('drift = { code = "D", text = "a\\nb" }', ("text is 'a\\nb'", "one line")),
        (f'drift = {{ code = "D", text = "{"t" * 201}" }}', ("(201 characters)", "1 to 200")),
        ('drift = { code = "D 1", text = "t" }', ("code is 'D 1'", "letters, digits and . _ -")),
        ('drift = { code = 7, text = "t" }', ("code is 7", "letters, digits and . _ -")),
        ('drift = { text = "t" }', ("failure_codes.drift.code is missing",)),
        ('drift = { code = "D", text = "t", dispositon = "x" }', ("did you mean 'disposition'",)),
        ('drift = "D"', ("failure_codes.drift is 'D'",)),
        (
            'drift = { code = "D", text = "t" }\nnoise_floor = { code = "D", text = "u" }',
            ("failure_codes.noise_floor.code is 'D', which 'drift' gives the text 't'", "one code has one meaning"),
        ),
        (
            'drift = { code = "D", text = "t" }\nnoise_floor = { code = "D", text = "t", disposition_again = "a" }',
            ("failure_codes.noise_floor.code", "one code has one meaning"),
        ),
        (
            'drift = { code = "D", text = "t" }\nnoise_floor = { code = "D", text = "t", disposition = "scrap" }',
            ("failure_codes.noise_floor.code", "one code has one meaning"),
        ),
    ],
)
def test_what_is_wrong_is_named_with_file_line_and_key(recipe, codes, said):
    with pytest.raises(ConfigError) as caught:
        recipe(codes)
    for words in ("own.toml line ", *said):
        assert words in str(caught.value), str(caught.value)


def test_a_table_of_another_type_is_refused(recipe, tmp_path):
    recipe("")
    text = (tmp_path / "own.toml").read_text().replace("[failure_codes]", "")
    (tmp_path / "own.toml").write_text(f"failure_codes = 3\n{text}")
    with pytest.raises(ConfigError, match="failure_codes is 3; it must be a table"):
        load_recipe(tmp_path / "own.toml")
