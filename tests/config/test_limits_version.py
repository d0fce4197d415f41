"""Limits with a version: taken in from a file of their own, sealed, stored with the run, and shown in its report."""

import json
import tomllib
from dataclasses import replace

import pytest
from report_samples import sample_run

from cbsr_qa.app.run.render import with_versions
from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.limits import limits_digest
from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type, load_station
from cbsr_qa.config.merging import merge, restore
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.limits import Limit, LimitsVersion
from cbsr_qa.report.render import render_run
from cbsr_qa_plugins.sections.limits import Limits

LIMIT = """
[[limits]]
measurement = "shape_deviation"
unit = "mm²"
upper = 7.5
marginal = 0.5
phase = "nine locations"
version = "golden-3"
"""
SEAL = limits_digest(tomllib.loads(LIMIT)["limits"])
HEADER = f"""[limits_version]
version = "golden-3"
date = "2026-11-21"
lot = "batch B7: 30 sensors"
serials = ["S-1", "S-2"]
coverage_percent = 99.0
confidence_percent = 95.0
rule = "fails outside the limit"
data_sha256 = "{"0" * 64}"
limits_sha256 = "{SEAL}"
"""


@pytest.fixture
def recipe(tmp_path):
    """Write a recipe that takes its limits from a file, and return how to load it."""
    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text

    def load(limits=HEADER + LIMIT, added="", line='limits_from = "golden.toml"'):
        (tmp_path / "golden.toml").write_text(limits)
        text = shipped.replace("[[phases]]", f"{line}\n\n[[phases]]", 1) + added
        (tmp_path / "own.toml").write_text(text)
        return load_recipe(tmp_path / "own.toml")

    return load


def refused(recipe, *said, **changes):
    with pytest.raises(ConfigError) as caught:
        recipe(**changes)
    for words in said:
        assert words in str(caught.value), str(caught.value)


def test_a_recipe_judges_by_its_own_limits_and_those_of_the_file(recipe):
    loaded = recipe().value
    shipped = load_recipe("nine-locations").value
    assert loaded.limits[:-1] == shipped.limits
    assert loaded.limits[-1] == Limit(
        "shape_deviation", "mm²", None, 7.5, 0.5, phase="nine locations", version="golden-3"
    )
    assert loaded.limits_version == LimitsVersion(
        "golden-3", "2026-11-21", "batch B7: 30 sensors", 99.0, 95.0, "fails outside the limit", "0" * 64, True
    )
    assert shipped.limits_version is None


def test_a_file_and_the_same_tables_pasted_are_one_configuration(recipe):
    from_file = recipe().document.data
    pasted = recipe(added=HEADER + LIMIT, line="").document.data
    assert from_file == pasted
    assert "limits_from" not in json.dumps(from_file)


def test_the_version_is_stored_with_the_run_and_needs_no_file_afterwards(recipe, tmp_path):
    station, loaded = load_station("simulated"), recipe()
    stored = merge(station, loaded, load_sensor_type("disc-100mm"), load_material("cbsr-8wt"), seed=1)
    (tmp_path / "golden.toml").unlink()
    again = restore(stored.canonical).recipe
    assert (again.limits_version, again.limits) == (loaded.value.limits_version, loaded.value.limits)


@pytest.mark.parametrize(
    ("old", "new"),
    [("upper = 7.5", "upper = 7.6"), ("marginal = 0.5", "marginal = 0.0"), ("mm²", "mm2"), ("upper", "lower")],
)
def test_a_limit_changed_behind_its_seal_is_refused(recipe, old, new):
    refused(recipe, "limits_sha256", "golden-3", "propose", limits=HEADER + LIMIT.replace(old, new))


def test_limits_added_behind_the_seal_are_refused_too(recipe):
    more = LIMIT.replace("shape_deviation", "ringing")
    refused(recipe, "of the 2 limits", limits=HEADER + LIMIT + more)


def test_limits_set_by_hand_have_a_version_without_a_seal(recipe):
    by_hand = '[limits_version]\nversion = "golden-3"\ndate = "2026-11-22"\n'
    version = recipe(limits=by_hand + LIMIT.replace("7.5", "8")).value.limits_version
    assert (version.version, version.sealed, version.coverage_percent) == ("golden-3", False, None)


def test_what_does_not_fit_is_named(recipe):
    own = LIMIT.replace('version = "golden-3"\n', "")
    refused(recipe, "shape_deviation", "golden.toml", "remove one", added=own)
    refused(recipe, "'golden-3'", "'golden-4'", limits=HEADER.replace("golden-3", "golden-4") + LIMIT)
    refused(recipe, "there is no [limits_version]", added=LIMIT, line="")
    refused(recipe, "has no version", limits=HEADER + own)
    refused(recipe, "limits_from", "does not exist", line='limits_from = "nowhere.toml"')
    refused(
        recipe, "own.toml", "golden.toml", "line 3", "date", limits=(HEADER + LIMIT).replace("2026-11-21", "today")
    )
    refused(recipe, "is stated here and in", added='[limits_version]\nversion = "a"\ndate = "2026-11-21"\n')
    refused(recipe, "phase", "'ten locations'", limits=unsealed(LIMIT.replace("nine", "ten")))


def unsealed(limits):
    return HEADER.replace(f'limits_sha256 = "{SEAL}"\n', "") + limits


def test_the_seal_does_not_depend_on_order_or_on_written_defaults():
    limit = tomllib.loads(LIMIT)["limits"][0]
    other = {**limit, "measurement": "ringing"}
    assert limits_digest([limit, other]) == limits_digest([other, limit])
    assert limits_digest([{**limit, "qualifier": "", "upper": 7.50}]) == SEAL


def test_limits_from_the_store_get_their_version_back():
    limit = Limit("ringing", "1", None, 0.4, version="golden-3")
    measured = sample_run(size_mm=8.0).measurements
    stored = [replace(measured[0], limit=replace(limit, version="")), replace(measured[1], limit=None)]
    again = with_versions(stored, [limit])
    assert [m.limit for m in again] == [limit, None]
    other = replace(limit, upper=0.5, version="golden-4")
    assert with_versions(stored, [other])[0].limit.version == ""


def test_the_report_shows_the_version_beside_the_limits():
    result = sample_run(size_mm=8.0)
    assert "Version" not in render_run(result, [Limits()])
    version = LimitsVersion("golden-3", "2026-11-21", "batch <B7>", 99.0, 95.0, "fails outside", sealed=True)
    measured = tuple(
        m if m.limit is None else replace(m, limit=replace(m.limit, version="golden-3")) for m in result.measurements
    )
    judged = sum(m.limit is not None for m in measured)
    html = render_run(replace(result, measurements=measured, limits_version=version), [Limits()])
    assert f"{judged} limits of version golden-3, made 2026-11-21 from the golden lot batch &lt;B7&gt;." in html
    assert "99 % of good sensors with 95 % confidence" in html
    assert html.count("golden-3") >= judged + 1
    assert "They may have been changed" not in html
    unsealed_html = render_run(replace(result, limits_version=replace(version, sealed=False)), [Limits()])
    assert "They may have been changed" in unsealed_html
