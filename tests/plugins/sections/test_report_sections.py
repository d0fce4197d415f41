"""Sections of a run: what they show is what was measured, and they are silent where there is nothing to show."""

import re
from dataclasses import replace

import pytest
from recording_samples import sample_recording
from report_samples import ended_early, without_blobs
from section_texts import blocks, check_showable, observed, tables, texts
from tiers import rest_but

from cbsr_qa.domain.results.relaxation import FitStatus
from cbsr_qa.domain.results.report import Figure, Paragraph
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa_plugins.sections.data_sheet import BaselineConductanceMap
from cbsr_qa_plugins.sections.loads import LoadImages
from cbsr_qa_plugins.sections.noise_and_contacts import NoiseAndContacts
from cbsr_qa_plugins.sections.relaxation import RelaxationFits
from cbsr_qa_plugins.sections.time_and_accuracy import TimeAndAccuracy
from cbsr_qa_plugins.sections.traceability import Traceability

PLUGINS = discover()
OF_A_RUN = [name for name in PLUGINS.names(Kind.SECTION) if not name.startswith(("recording", "characterisation"))]


def made(name):
    return PLUGINS.factory(Kind.SECTION, name)()


@pytest.mark.parametrize("name", OF_A_RUN)
def test_every_section_has_content_that_can_be_shown(name, result):
    check_showable(made(name).render(result))


@pytest.mark.parametrize("name", OF_A_RUN)
def test_a_recording_is_none_of_their_business(name):
    assert made(name).render(sample_recording(1)) is None


@pytest.mark.parametrize("name", OF_A_RUN)
def test_a_run_that_was_not_analysed_gets_only_what_it_has(name, result):
    section = made(name).render(ended_early(result))
    assert (section is None) == (name not in ("station-check", "traceability"))


@pytest.mark.parametrize("name", rest_but({"relaxation", "load-images", "traceability"}, OF_A_RUN))
def test_a_run_in_which_nothing_was_seen_is_reported_too(name, result):
    """Numbers, pictures and neither stay in ``make test``."""
    section = made(name).render(without_blobs(result))
    words = " ".join(cell.text for table in tables(section) for row in table.rows for cell in row)
    assert "nan" not in words.lower()


def test_not_settled_is_a_bound_and_never_a_number(result):
    loads = list(result.observation.loads)
    first = loads[0].relaxations[0]
    late = replace(first, settling=replace(first.settling, value_s=60.0, censored=True))
    loads[0] = replace(loads[0], relaxations=(late, *loads[0].relaxations[1:]))
    section = RelaxationFits().render(observed(result, loads=tuple(loads)))
    row = next(row for row in texts(tables(section)[1]) if row[5] == "1")
    assert row[3].startswith("≥ ")


def test_rejected_fits_are_counted_by_reason(result):
    loads = []
    for k, load in enumerate(result.observation.loads):
        worst = load.relaxations[0]
        why = f"R² {0.4 + k / 100:.3f} is below 0.85" if k != 7 else "the data do not determine a time constant"
        fit = replace(worst.fit, status=FitStatus.REJECTED, r_squared=0.4 + k / 100, why=why)
        bad = replace(worst, fit=fit, settling=replace(worst.settling, value_s=None))
        loads.append(replace(load, relaxations=(bad, *load.relaxations[1:])))
    section = RelaxationFits().render(observed(result, loads=tuple(loads)))
    (told,) = [block.text for block in blocks(section, Paragraph)]
    assert told == (
        "23 fits were rejected: 22 with R² below 0.85 (0.40 to 0.62), 1 because the data do not determine a time"
        " constant."
    )
    by_strain = [row for row in texts(tables(section)[1]) if row[:2] == ["conductance", "press"]]
    assert {row[3] for row in by_strain} == {"–"}


def test_the_baseline_section_says_what_was_assumed_and_reduced(result):
    section = BaselineConductanceMap().render(result)
    words = [block.text for block in blocks(section, Paragraph)]
    assert any("α and β against stress" in text and "not measured" in text for text in words)
    assert any("only one strain" in text for text in words)
    assert BaselineConductanceMap().render(replace(result, calibration=None)) is None


def test_a_baseline_without_any_value_is_said_without_a_figure(result):
    empty = tuple(replace(place, value=None, stderr=None, why="no blob") for place in result.calibration.baseline)
    section = BaselineConductanceMap().render(
        replace(result, calibration=replace(result.calibration, baseline=empty))
    )
    assert not blocks(section, Figure)
    assert {row[4] for row in texts(tables(section)[0])} == {"no blob"}


def test_the_worst_contact_is_named(result):
    bad = [replace(m, value=95e3) if m.qualifier == "pair 7-8" else m for m in result.measurements]
    section = NoiseAndContacts().render(replace(result, measurements=tuple(bad)))
    captions = " ".join(block.caption for block in blocks(section, Figure))
    assert re.search(r"pair 7.8 with 95.0.kΩ", captions)


def test_time_adds_up(result):
    section = TimeAndAccuracy().render(result)
    (table,) = tables(section)
    assert [row[2] for row in texts(table)] == ["3", "9", "10", "1"]
    assert "55 min" in section.blocks[0].text


@pytest.mark.rest
def test_only_so_many_images_are_printed_and_the_rest_is_said(result):
    many = tuple(replace(load) for load in 3 * result.observation.loads)
    section = LoadImages().render(observed(result, loads=many))
    assert section.blocks[0].text.endswith("21 presses are not printed here; every frame is in the store.")


@pytest.mark.parametrize(("name", "criterion"), [("λ", "gcv"), ("components kept", "noise-figure"), ("μ", "")])
def test_the_regularisation_parameter_stands_under_its_own_name(result, name, criterion):
    prepared = result.observation.reconstruction
    choice = replace(prepared.choice, name=name, criterion=criterion)
    seen = observed(result, reconstruction=replace(prepared, choice=choice))
    rows = dict(texts(tables(Traceability().render(seen))[2]))
    assert rows["Regularisation parameter"] == f"{name} = 0.0123"
    said = criterion or "criterion not stated"
    assert rows["Parameter chosen by"] == f"{said}: noise figure 1.00 on the nominal model"


def test_instruments_are_traceable(result):
    told = {"simulated": False, "calibration_due": "2027-01-31", "notes": (("address", "COM3"), ("tare", "0.02 N"))}
    bench = replace(result.record.identity.instruments[0], **told)
    identity = replace(result.record.identity, instruments=(bench, replace(bench, calibration_due=None, notes=())))
    section = Traceability().render(replace(result, record=replace(result.record, identity=identity)))
    rows = texts(tables(section)[0])
    assert rows[0][-2:] == ["2027-01-31", "address: COM3; tare: 0.02 N"]
    assert rows[1][-2:] == ["not stated", "–"]
    words = " ".join(cell for table in tables(section) for row in texts(table) for cell in row)
    assert result.record.identity.configuration_digest in words


@pytest.mark.parametrize(
    ("why", "words"),
    [
        (
            "the verdict is fail, so no calibration is issued: drift is 2",
            "the verdict is fail, so no calibration is issued",
        ),
        ("the run was broken: rule 'force'", "the run was broken"),
        ("the recipe has no phase to calibrate from", "the recipe has no phase to calibrate from"),
    ],
)
def test_why_there_is_no_calibration_does_not_repeat_the_banner(result, why, words):
    verdict = replace(result.verdict, reason="drift is 2")
    record = replace(result.record, end_detail="rule 'force'")
    assert replace(result, verdict=verdict, record=record, calibration_why=why).calibration_words == words
