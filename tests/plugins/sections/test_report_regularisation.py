"""The section of the regularisation parameter: what is drawn is what was chosen, and from what."""

from dataclasses import replace

import numpy as np
import pytest
from recording_samples import sample_recording
from report_samples import sample_run
from section_texts import blocks, observed, tables, texts
from sensor_samples import SENSOR
from tiers import rest_but

from cbsr_qa.domain.results.report import Figure, Paragraph
from cbsr_qa.eit.inverse.noise_figures import evidence_of
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.report.draw.parameter import parameter_figure
from cbsr_qa.report.draw.style import INK, drawing
from cbsr_qa.report.svg import check_svg
from cbsr_qa.report.tables import number
from cbsr_qa_plugins.reconstruction.direct import Greit, LinearBackProjection, TruncatedSvd
from cbsr_qa_plugins.reconstruction.one_step import (
    GaussNewtonIndenter,
    GaussNewtonLaplace,
    GaussNewtonNoser,
    GaussNewtonTikhonov,
)
from cbsr_qa_plugins.sections import image_quality
from cbsr_qa_plugins.sections.image_quality import RegularisationParameter

RIDGES = (GaussNewtonNoser, GaussNewtonTikhonov, GaussNewtonLaplace, GaussNewtonIndenter)
CRITERIA = ("noise-figure", "gcv", "l-curve", "discrepancy")


@pytest.fixture(scope="module")
def problem():
    return imaging_problem(SENSOR, image_size_mm=6.0)


@pytest.fixture(scope="module")
def result():
    return sample_run(size_mm=8.0)


@pytest.fixture
def section_of(result):
    def make(prepared):
        return RegularisationParameter().render(observed(result, reconstruction=prepared))

    return make


@pytest.fixture
def canvas_of(section_of, monkeypatch):
    """Return the two axes of the figure as they were drawn."""

    def make(prepared):
        canvases = []

        def kept(*given):
            with drawing():
                canvases.append(parameter_figure.__wrapped__(*given))
                canvases[0].draw_without_rendering()
            return ""

        with monkeypatch.context() as patched:
            patched.setattr(image_quality, "parameter_figure", kept)
            section_of(prepared)
        return canvases[0].axes

    return make


def marks(axes):
    """Places of all marks in data coordinates, and of the full one; those of the key are in axes coordinates."""
    drawn = [line for line in axes.lines if len(line.get_xdata()) == 1 and line.get_transform() == axes.transData]
    places = [(line.get_xdata()[0], line.get_ydata()[0]) for line in drawn]
    return places, [p for p, line in zip(places, drawn, strict=True) if line.get_markerfacecolor() == INK]


@pytest.mark.rest
@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("method", [*RIDGES, TruncatedSvd])
def test_the_full_mark_lies_at_the_choice_and_on_the_curve(problem, canvas_of, method, criterion):
    prepared = method(choose=criterion).prepare(problem)
    choice, curve = prepared.choice, prepared.choice.curve
    whole, close = canvas_of(prepared)
    for axes in (whole, close):
        ((x, y),) = marks(axes)[1]
        assert x == choice.value
        assert y == pytest.approx(choice.noise_figure, rel=1e-6)
        low, high = sorted(axes.get_xlim())
        assert low < x < high
        low, high = sorted(axes.get_ylim())
        assert low < y < high
    answers = [answer.value for answer in curve.answers]
    assert [x for x, _ in marks(close)[0]] == answers
    assert all(y == curve.noise_figure_at(x) for x, y in marks(close)[0])


@pytest.mark.parametrize("method", rest_but({GaussNewtonNoser, TruncatedSvd}, [*RIDGES, TruncatedSvd]))
def test_nothing_but_numbers_is_drawn(problem, section_of, method):
    (figure,) = blocks(section_of(method().prepare(problem)), Figure)
    assert "nan" not in check_svg(figure.svg).lower()
    assert "inf" not in figure.svg.lower()
    assert ">noise figure<" in figure.svg  # the axis has a name


def test_the_words_hold_criterion_value_and_reason(problem, section_of):
    prepared = GaussNewtonLaplace(choose="gcv").prepare(problem)
    section = section_of(prepared)
    (words,) = blocks(section, Paragraph)
    assert f"λ = {number(prepared.choice.value)}, chosen by generalised cross-validation" in words.text
    assert "32 simulated frames (seed 3)" in words.text
    (table,) = tables(section)
    rows = texts(table)
    assert [row[0] for row in rows] == ["noise figure", "cross-validation (chosen)", "L-curve", "discrepancy"]
    assert rows[0][2] == "1.00"
    assert rows[1][1] == number(prepared.choice.value)


def test_the_target_is_drawn_where_it_was_asked_for(problem, canvas_of):
    for target in (0.7, 2.0):
        prepared = GaussNewtonNoser(noise_figure=target).prepare(problem)
        for axes in canvas_of(prepared):
            (level,) = {y for line in axes.lines if line.get_linestyle() == "--" for y in line.get_ydata()}
            assert level == target
            ((_, y),) = marks(axes)[1]
            assert y == pytest.approx(target, rel=1e-6)


def test_a_criterion_without_an_answer_is_named_without_a_mark(problem, section_of, canvas_of):
    once = imaging_problem(SENSOR, used=np.triu(SENSOR.pattern.usable()), image_size_mm=6.0)
    sampled = replace(once, sample=evidence_of(once).changes)
    prepared = GaussNewtonLaplace(choose="gcv").prepare(sampled)
    assert len(marks(canvas_of(prepared)[1])[0]) == 3
    section = section_of(prepared)
    (table,) = tables(section)
    assert texts(table)[3][:3] == ["discrepancy", "–", "–"]
    assert "no reading is repeated" in table.rows[3][3].text
    (figure,) = blocks(section, Figure)
    assert "no answer" in figure.svg
    assert "discrepancy" not in figure.alternative


@pytest.mark.parametrize("method", [GaussNewtonNoser, TruncatedSvd])
def test_a_sensor_with_bad_channels_keeps_its_types_curve_and_says_its_own_noise_figure(problem, section_of, method):
    used = SENSOR.pattern.usable()
    used[4], used[:, 7] = False, False
    masked = imaging_problem(SENSOR, used=used, image_size_mm=6.0)
    whole, own = (method().prepare(each) for each in (problem, masked))
    assert np.array_equal(whole.choice.curve.noise_figures, own.choice.curve.noise_figures)
    words = [blocks(section_of(each), Paragraph)[0].text for each in (whole, own)]
    assert "of this sensor" not in words[0]
    figure = number(own.choice.noise_figure)
    assert f"The matrix of this sensor, from {int(used.sum())} readings, has noise figure {figure}." in words[1]


def test_weights_of_the_readings_are_said(problem, section_of):
    noise = np.random.default_rng(2).uniform(0.3, 3.0, len(problem.reference))
    weighted = imaging_problem(SENSOR, noise_variance=noise**2, image_size_mm=6.0)
    prepared = GaussNewtonNoser().prepare(weighted)
    words = blocks(section_of(prepared), Paragraph)[0].text
    assert f"weighted by their noise, has noise figure {number(prepared.choice.noise_figure)}." in words


def test_counts_are_written_as_such(problem, section_of):
    prepared = TruncatedSvd().prepare(problem)
    section = section_of(prepared)
    (words,) = blocks(section, Paragraph)
    assert f"components kept = {prepared.choice.value:.0f}, chosen by" in words.text
    assert tables(section)[0].columns[1] == "Components kept"


@pytest.mark.parametrize(
    ("method", "said"),
    [
        (LinearBackProjection(), "has no regularisation parameter"),
        (GaussNewtonNoser(hyperparameter=0.1), "λ = 0.100: hyperparameter given."),
    ],
)
def test_nothing_is_drawn_where_nothing_was_chosen(problem, section_of, method, said):
    section = section_of(method.prepare(problem))
    (words,) = section.blocks
    assert said in words.text
    assert "Its matrix has noise figure" in words.text


def test_recordings_and_runs_without_images_have_no_section(result):
    assert RegularisationParameter().render(sample_recording()) is None
    assert RegularisationParameter().render(replace(result, observation=None)) is None


@pytest.mark.rest
def test_the_few_values_that_greit_tried_are_drawn_as_they_were(problem, canvas_of):
    """Each λ is a fit of its own: the curve holds those of the search, whatever was searched before."""
    prepared = Greit(noise_figure=0.7).prepare(problem)
    choice, curve = prepared.choice, prepared.choice.curve
    assert 3 <= len(curve.values) < 15
    assert (np.diff(curve.values) > 0).all()
    assert (np.diff(curve.noise_figures) < 0).all()
    assert curve.noise_figure_at(choice.value) == choice.noise_figure
    for at in (0, -1):
        assert Greit(hyperparameter=float(curve.values[at])).prepare(problem).choice.noise_figure == pytest.approx(
            curve.noise_figures[at], rel=1e-9
        )
    Greit(noise_figure=0.6).prepare(problem)
    assert np.array_equal(Greit(noise_figure=0.7).prepare(problem).choice.curve.values, curve.values)
    for axes in canvas_of(prepared):
        assert marks(axes)[1] == [(choice.value, choice.noise_figure)]
        assert len(curve.values) in {len(line.get_xdata()) for line in axes.lines if line.get_marker() == "."}
