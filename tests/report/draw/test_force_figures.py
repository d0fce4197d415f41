"""Figures of the force section: whatever the numbers, they are drawn, safe, and say what they were given."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st
from report_samples import sample_run
from sensor_samples import SENSOR
from tiers import rest_but

from cbsr_qa.report.draw.force import ForcePanel, RatioPoints, fit_stated_error, force_figure, ratio_figure
from cbsr_qa.report.draw.maps import SheetField, force_map_figure, round_levels
from cbsr_qa.report.svg import check_svg
from cbsr_qa_plugins.sections import force
from cbsr_qa_plugins.sections.force import Force

_NONE = np.zeros(0)


def panel(measured, error, stated=0.1, missed=_NONE, sampled=None):
    measured = np.asarray(measured, dtype=np.float64)
    which = np.ones(len(measured), dtype=bool) if sampled is None else sampled
    return ForcePanel("place known", measured, measured + error, np.full(len(measured), stated), which, missed)


def field(values, about=None):
    x = np.linspace(-50, 50, values.shape[1])
    return SheetField("response", "%", x, np.linspace(-50, 50, values.shape[0]), values, about)


def drawn_map(fields, used=((0.0, 0.0),), refused=()):
    return force_map_figure(
        fields,
        SENSOR,
        used_mm=np.array(used).reshape(-1, 2),
        refused_mm=np.array(refused).reshape(-1, 2),
        radius_mm=30.0,
    )


def looks_whole(figure):
    check_svg(figure)
    assert "nan" not in figure.lower()
    assert "inf" not in figure.lower()
    return True


@pytest.mark.parametrize(
    "shown",
    [
        panel([2.0], 0.0, stated=0.0),
        panel([1.0, 2.0], 0.1, missed=np.array([0.4, 9.0])),
        panel([], 0.0, missed=np.array([0.4])),
        *(
            pytest.param(shown, marks=pytest.mark.rest)
            for shown in (
                panel([2.0, 2.0, 2.0], [0.1, -0.1, 0.0]),
                panel([1e-9, 2e-9], 1e-10, stated=1e-9),
                panel([1e6, 3e6], 1e5, stated=1e4),
                panel([1.0, 2.0], -5.0),
                panel([1.0, 2.0], 0.1, sampled=np.zeros(2, dtype=bool)),
            )
        ),
    ],
)
def test_any_loads_can_be_drawn(shown):
    flat = panel([1.0, 2.0, 3.0], [0.0, 100.0, -100.0], stated=np.inf)
    assert looks_whole(force_figure([shown], None))
    assert looks_whole(force_figure([shown, shown], flat))


def test_loads_beyond_the_edge_are_marks_and_do_not_flatten_the_others():
    shown = panel([1.0, 2.0, 3.0], 0.1)
    figure = force_figure([shown], panel([1.0, 2.0], [0.05, 100.0]))
    levels = [float(text.replace("−", "-")) for text in re.findall(r">(−?[\d.]+)</text>", figure)]
    assert levels
    assert max(levels) <= 4


@given(st.floats(0, 2), st.floats(0, 1), st.integers(2, 30))
def test_stated_errors_that_grow_as_the_model_says_are_met_exactly(level, growth, count):
    force = np.linspace(0.5, 5, count)
    stated = np.sqrt(level**2 + growth**2 * force**2)
    np.testing.assert_allclose(fit_stated_error(force, stated, force), stated, atol=1e-6 * (level + growth))


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=20))
def test_bands_are_real_whatever_the_stated_errors(stated):
    found = fit_stated_error(np.linspace(1, 3, len(stated)), np.array(stated), np.linspace(0, 5, 20))
    assert np.isfinite(found).all()
    assert (found >= 0).all()


@given(st.floats(1e-9, 1e6), st.floats(1, 1e6))
@drawn(50)
def test_levels_hold_all_values_between_round_numbers(least, ratio):
    most = least * ratio
    levels = round_levels(least, most)
    assert levels[0] == 0
    assert (np.diff(levels) > 0).all()
    assert levels[-1] >= most * (1 - 1e-9)
    digits = levels[1:] / 10.0 ** np.floor(np.log10(levels[1:]) + 1e-9)
    assert all(np.isclose(digit, (1, 2, 5)).any() for digit in digits)


_HILL = np.exp(-((np.mgrid[-1:1:21j, -1:1:21j] ** 2).sum(axis=0)))


@pytest.mark.rest
@pytest.mark.parametrize(
    "shown",
    [
        field(np.ones((21, 21)), about=1.0),
        field(np.zeros((21, 21))),
        field(np.full((21, 21), 3.7)),
        field(1 + 1e-12 * _HILL, about=1.0),
        field(1e4 * _HILL, about=1.0),
        field(1e-7 * _HILL),
        field(1 + 0.2 * _HILL, about=1.0),
        field(np.geomspace(1e-4, 1e3, 441).reshape(21, 21)),
    ],
)
def test_any_map_can_be_drawn(shown):
    assert looks_whole(drawn_map([shown]))
    assert looks_whole(drawn_map([shown, shown], refused=((10.0, 5.0), (45.0, 0.0))))


def test_the_scale_of_a_map_is_that_of_the_sheet_and_not_of_the_corners_beside_it():
    values = np.full((21, 21), 1.1)
    values[0, 0] = 900.0
    assert not any(f">{level}<" in drawn_map([field(values, about=1.0)]) for level in (200, 400, 500, 800, 900))


@pytest.mark.parametrize("count", [1, 2, 40])
@pytest.mark.parametrize("scale", rest_but({1.0}, [1e-6, 1.0, 1e6]))
def test_any_ratios_can_be_drawn(count, scale):
    force = scale * np.linspace(1, 5, count)
    ones = np.ones(count)
    line = scale * np.linspace(1, 5, 10)
    points = RatioPoints(force, 0.8 * ones, ones, 0.01 * ones, line, np.ones(10), np.zeros(10))
    assert looks_whole(ratio_figure(points))


@pytest.mark.rest
def test_a_run_without_a_force_model_says_why():
    result = sample_run(size_mm=6.0)
    section = Force().render(result)
    assert section.title == "Force"
    assert section.blocks[0].tone == "warning"
    assert section.blocks[0].text.startswith("This sensor has no force model: ")
    silent = tuple(m for m in result.measurements if m.name != "force_error_sd")
    assert (
        Force().render(result.__class__(result.record, result.observation, silent, result.verdict, None, "")) is None
    )


def test_open_marks_are_explained_where_they_are_drawn():
    words = "open: repeated presses of one place"
    assert words in force_figure([panel([1.0, 2.0], 0.1, sampled=np.array([True, False]))], None)
    assert words not in force_figure([panel([1.0, 2.0], 0.1)], None)


def test_a_response_that_is_the_same_all_over_is_no_range(monkeypatch):
    for spread, words in ((1e-4, "the response is 0.95 times the material's"), (0.02, "0.93 to 0.97 times")):
        quality = SimpleNamespace(
            response=np.array([0.95 - spread, 0.95 + spread]),
            stderr=np.array([0.01]),
            spread=spread,
            rms_error=0.01,
            least_sure_mm=(0.0, 0.0),
        )
        monkeypatch.setattr(force, "map_quality", lambda *_, quality=quality: quality)
        monkeypatch.setattr(force, "calibration_radius_mm", lambda _: 40.0)
        learned = SimpleNamespace(model=SimpleNamespace(scatter=0.01))
        assert words in force._map_words(None, None, learned)
