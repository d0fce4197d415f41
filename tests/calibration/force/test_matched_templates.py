"""Heads found and weighed by their templates: against exact fields of loads whose place and strength are known."""

import numpy as np
import pytest
from force_samples import HEAD, setting, somewhere

from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.force.templates import CONTRAST, make_even_model
from cbsr_qa.domain.readings.loads import Indenter


@pytest.fixture(scope="module")
def model():
    here = setting()
    return make_even_model(here.bank, here.readings.merging)


@pytest.fixture(scope="module")
def finder(model):
    return TemplateFilter(model)


def strength(contrast):
    return 2 * contrast / (2 + contrast)


class TestKnownPlace:
    @pytest.mark.parametrize(("radius_mm", "error"), [(30.0, 5e-5), (40.0, 5e-4)])
    def test_templates_between_nodes_are_those_of_the_exact_field(self, finder, radius_mm, error):
        random = np.random.default_rng(1)
        places = somewhere(random, 300, radius_mm)
        rows = setting().rows(places, np.full(300, CONTRAST))
        found = finder.match_at(rows, places)
        assert found.strength == pytest.approx(strength(CONTRAST), rel=error)
        assert found.gain == pytest.approx((rows**2).sum(axis=1), rel=10 * error)

    @pytest.mark.parametrize("contrast", [-0.1, 0.02, 0.3])
    def test_strength_is_linear_in_what_it_is_called(self, finder, contrast):
        # Within 30 mm of the centre the readings follow 2κ/(2 + κ) to half a percent.
        places = somewhere(np.random.default_rng(2), 100, 30.0)
        rows = setting().rows(places, np.full(100, contrast))
        assert finder.match_at(rows, places).strength == pytest.approx(strength(contrast), rel=5e-3)

    def test_noise_gives_the_stated_variance(self, finder):
        random = np.random.default_rng(3)
        places = somewhere(random, 4000)
        found = finder.match_at(random.standard_normal((4000, finder.templates.shape[1])), places)
        scores = found.strength / np.sqrt(found.covariance[:, 0, 0])
        assert np.mean(scores**2) == pytest.approx(1, abs=0.09)  # four standard errors
        assert (found.covariance[:, 1:, 1:] == 0).all()

    def test_no_template_beyond_the_nodes(self, finder):
        outside = np.array([[60.0, 0.0], [49.0, 0.0], [np.nan, 0.0]])
        assert np.isnan(finder.template(outside)).all()

    def test_another_size_of_head_is_followed_linearly(self, model):
        places = somewhere(np.random.default_rng(4), 50, 25.0)
        head = Indenter(10.0)
        finder = TemplateFilter(model, size=head.squared_radius_mm2 / HEAD.squared_radius_mm2)
        found = finder.match_at(setting().rows(places, np.full(50, 0.1), head), places)
        assert found.strength * HEAD.area_mm2 / head.area_mm2 == pytest.approx(strength(0.1), rel=5e-3)


class TestSearch:
    @pytest.mark.parametrize(("radius_mm", "rms_mm"), [(20.0, 0.02), (36.0, 0.05), (40.0, 0.2)])
    def test_a_head_is_found_where_it_is(self, finder, radius_mm, rms_mm):
        places = somewhere(np.random.default_rng(5), 400, radius_mm)
        found = finder.search(setting().rows(places, np.full(400, CONTRAST)))
        assert np.sqrt(np.mean((found.place_mm - places) ** 2)) < rms_mm

    def test_scatter_is_what_the_information_allows(self, finder):
        random = np.random.default_rng(6)
        places = somewhere(random, 2000, 34.0)
        rows = setting().rows(places, np.full(2000, CONTRAST))
        found = finder.search(rows + random.standard_normal(rows.shape))
        error = np.column_stack([found.strength - strength(CONTRAST), found.place_mm - places])
        squared = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
        assert np.mean(squared) == pytest.approx(3, abs=0.35)  # χ² of three unknowns

    def test_a_search_never_finds_less_than_the_truth_explains(self, finder):
        random = np.random.default_rng(7)
        places = somewhere(random, 300, 34.0)
        rows = setting().rows(places, np.full(300, 0.08))
        rows += random.standard_normal(rows.shape)
        given = finder.match_at(rows, places).gain
        less = given - finder.search(rows).gain
        assert (less < 0.2 + 3e-4 * given).all()  # 0.2 of the 2 that two coordinates gain; interpolation
        assert (less > 0).mean() < 0.05

    def test_noise_alone_reaches_the_threshold_as_often_as_it_says(self, model, finder):
        random = np.random.default_rng(8)
        gains = finder.search(random.standard_normal((20_000, finder.templates.shape[1]))).gain
        assert (gains > model.threshold**2).mean() < 5e-4  # 1e-4 a frame
        # One in a hundred frames is where as few can check it; maxima along the edge are not counted.
        lower = model.threshold**2 + 2 * np.log(1e-4 / 1e-2)
        assert 0.6e-2 < (gains > lower).mean() < 2e-2

    @pytest.mark.parametrize("power", [-60, -40, 40])
    def test_the_size_of_frames_moves_no_place(self, finder, power):
        """Below 1e-11 of their noise places were off by 3e-4 of a template's turn."""
        rows = finder.template(np.array([[3.3, -7.1], [-20.4, 11.2]]))
        usual, other = finder.search(rows), finder.search(2.0**power * rows)
        np.testing.assert_array_equal(other.place_mm, usual.place_mm)
        np.testing.assert_array_equal(other.strength, 2.0**power * usual.strength)

    def test_no_frames_no_answers(self, finder):
        assert len(finder.search(np.zeros((0, finder.templates.shape[1]))).strength) == 0

    def test_nothing_is_no_error(self, finder):
        found = finder.search(np.zeros((2, finder.templates.shape[1])))
        assert (found.gain == 0).all()
        assert np.isfinite(found.place_mm).all()


class TestBank:
    def test_second_moment_of_a_square_head(self):
        half = 5.0
        square = Indenter.with_outline([(-half, -half), (half, -half), (half, half), (-half, half)])
        assert square.squared_radius_mm2 == pytest.approx(2 * (2 * half) ** 2 / 6)  # ⟨r²⟩ = a²/6
        assert HEAD.squared_radius_mm2 == pytest.approx(6.5**2)

    def test_values_between_nodes_are_linear(self, model):
        places = model.lattice.places_mm()[model.node.ravel() >= 0]
        values = 1 + 0.02 * places[:, 0] - 0.01 * places[:, 1]
        at = np.array([[3.3, 4.7], [-20.1, 11.9], [80.0, 0.0]])
        found = interpolate(model, values, at)
        assert found[:2] == pytest.approx(1 + 0.02 * at[:2, 0] - 0.01 * at[:2, 1])
        assert np.isnan(found[2])
