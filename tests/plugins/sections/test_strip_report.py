"""The section of a characterised material shows what was found, and says what was left out and why."""

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from section_texts import blocks, check_showable, tables, texts
from strip_bench import strip_run

from cbsr_qa.analysis.evaluate import judge
from cbsr_qa.analysis.strip_cycles import characterise_run
from cbsr_qa.analysis.strip_measurements import measure_characterisation
from cbsr_qa.app.run.material_output import material_of, why_no_material
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.report import Figure, Paragraph
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.report.heads import run_page
from cbsr_qa_plugins.sections.characterisation import MaterialCharacterisation


@pytest.fixture(scope="module")
def result():
    record = strip_run(cycles=2)
    found = characterise_run(record, CharacterisationSettings())
    limits = (Limit("compressive_modulus", "kPa", 50.0, None),)
    measured = judge(measure_characterisation(found), limits)
    return RunResult(record, None, measured, Verdict(Outcome.PASS, "met"), None, "none", characterisation=found)


@lru_cache
def rendered(result):
    return MaterialCharacterisation().render(result)


def words(result):
    section = rendered(result)
    said = [p.text for p in blocks(section, Paragraph)]
    return " ".join([*said, *(text for table in tables(section) for row in texts(table) for text in row)])


def test_everything_can_be_shown(result):
    check_showable(rendered(result))
    assert len(blocks(rendered(result), Figure)) == 4
    assert not re.search(r"\bnan\b|None", words(result))


def test_the_parameters_are_those_that_were_found(result):
    parameters, strains, *_ = tables(rendered(result))
    row = next(row for row in parameters.rows if "gauge factor" in row[0].text)
    local, error = (float(text) for text in row[2].text.split(" ± "))
    line = result.characterisation.local_against_strain.line
    assert local == pytest.approx(line.slope.value, abs=error)
    assert error == pytest.approx(line.slope.stderr, rel=0.2)
    assert [row[0].text for row in strains.rows] == ["10", "20", "30"]
    assert {row[5].text for row in strains.rows} == {"used"}


def test_a_strain_that_was_left_out_is_named_and_drawn(result):
    found = result.characterisation
    weak = replace(found.levels[0], why="10 % strain: the deviation exceeds the mean change")
    changed = replace(result, characterisation=replace(found, levels=(weak, *found.levels[1:])))
    assert "Left out: 10 % strain: the deviation exceeds the mean change." in words(changed)
    assert "10 % left out" in blocks(rendered(changed), Figure)[0].svg
    assert "left out" not in blocks(rendered(result), Figure)[0].svg


def test_what_could_not_be_told_is_a_dash(result):
    (phase,) = result.record.phases
    record = replace(result.record, phases=(replace(phase, samples=()),))
    found = characterise_run(record, CharacterisationSettings())
    changed = replace(result, record=record, characterisation=found)
    warned = [p.text for p in blocks(rendered(changed), Paragraph) if p.tone == "warning"]
    assert any("No material file may be issued: no modulus" in text for text in warned)
    assert len(blocks(rendered(changed), Figure)) == 4
    assert why_no_material(changed) == found.refused[0]
    with pytest.raises(NumericsError, match="characterised no material"):
        material_of(changed)


def test_the_material_is_what_was_found_under_the_head(result):
    found, material = result.characterisation, material_of(result)
    assert material.against_strain == found.local_against_strain.line
    assert material.against_stress == found.local_against_stress.line
    assert material.against_strain.covariance < 0
    assert material.modulus_kPa == found.modulus_kPa
    assert material.loading_relaxation == found.loading
    assert material.name == "S"  # of the strip, where no batch is stated
    assert material.relative_noise.source.startswith("taken over from cbsr-8wt")
    assert "run on strip S" in material.modulus_kPa.source
    assert "squares" in material.interelectrode_resistance_ohm.source
    assert np.isfinite(material.modulus_kPa.stderr)


def test_only_what_passed_is_a_material(result):
    assert why_no_material(result) == ""
    failed = replace(result, verdict=Verdict(Outcome.FAIL, "too soft"))
    assert why_no_material(failed) == "the run did not pass: too soft"
    assert why_no_material(replace(result, characterisation=None)) == "nothing was characterised"


def test_the_head_of_the_report_says_what_was_issued(result):
    assert dict(run_page(result).identity)["Material file"] == "issued"
    failed = replace(result, verdict=Verdict(Outcome.FAIL, "too soft"))
    assert dict(run_page(failed).identity)["Material file"] == "none: the run did not pass"
    found = replace(result.characterisation, refused=("no modulus: nobody knows",))
    assert dict(run_page(replace(result, characterisation=found)).identity)["Material file"].endswith("nobody knows")
    assert "Calibration" in dict(run_page(replace(result, characterisation=None)).identity)


def test_other_recipes_have_no_such_section(result):
    assert MaterialCharacterisation().render(replace(result, characterisation=None)) is None
