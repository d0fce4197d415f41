"""GREIT: fits against explicit ones, masks against truth on another mesh, noise against random numbers."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import rest_but

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.imaging.blobs import nearest_blob
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.imaging.shape import spatial_figures
from cbsr_qa.eit.inverse.greit.greit import WIDTHS, GreitRows
from cbsr_qa.eit.inverse.greit.targets import TargetDesign, make_targets, node_areas_mm2
from cbsr_qa.eit.inverse.noise_figures import central_signal
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.readings import ReadingFold
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa_plugins.reconstruction.direct import Greit

HEAD_MM = 6.5


@pytest.fixture(scope="module")
def fine(sensor):
    return imaging_problem(sensor)


@pytest.fixture(scope="module")
def weighted(fine):
    return replace(fine, noise_variance=fine.reference**2, nominal=fine)


@pytest.fixture(scope="module")
def truth(sensor):
    """Readings of an unloaded sheet with other contacts than nominal ones, and of +50 % at the nine sites."""
    mesh = sheet_mesh(sensor, size_mm=4.0, order=2)
    contacts = np.full(sensor.electrodes.count, 0.3)
    local = LocalUpdate(ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), contacts, order=2))
    pressed = []
    for x, y in NINE_LOCATIONS_MM:
        covered = cover(local.model.elements, RoundFootprint(x, y, HEAD_MM))
        pressed.append(local.voltages(covered.elements, covered.change(local.model.conductance, 0.5)))
    return local.model.voltages(), np.array(pressed)


def figures(images, mesh):
    found = []
    for values, (x, y) in zip(images, NINE_LOCATIONS_MM, strict=True):
        region = nearest_blob(contour_regions(Image(mesh, values), 0.85), x, y)
        found += spatial_figures([region], RoundFootprint(x, y, HEAD_MM))
    return found


@pytest.mark.rest
@pytest.mark.parametrize("weights", ["equal", "known"])
def test_masks_of_loads_on_another_mesh_lie_on_the_loads(fine, weighted, truth, weights):
    one = fine if weights == "equal" else weighted
    images = Greit().prepare(one).images((truth[1] - truth[0])[:, one.used])
    found = figures(images, one.mesh)
    assert np.mean([one.error_mm for one in found]) < 0.1
    assert max(one.error_mm for one in found) < 0.2
    centre, *others = (one.overlap_percent for one in found)  # least seen, and so most blurred
    assert centre > 80
    assert min(others) > 97


@pytest.mark.rest
def test_weights_quieten_places_where_noise_follows_the_reading(fine, weighted, truth):
    """1 % of each reading, noise figure 0.25, the same frames for both."""
    random = np.random.default_rng(5)
    deviation = 0.01 * truth[0][fine.used]
    noise = deviation * random.standard_normal((len(truth[1]), 20, len(deviation)))
    change = (truth[1] - truth[0])[:, fine.used][:, None] + noise
    errors = []
    for one in (fine, weighted):
        prepared = Greit(noise_figure=0.25).prepare(one)
        scattered = [figures(prepared.images(change[:, frame]), one.mesh) for frame in range(change.shape[1])]
        errors.append(np.mean([found.error_mm for frame in scattered for found in frame]))
    assert errors[1] < 0.9 < errors[0]


@pytest.mark.parametrize("target", rest_but({0.5}, [0.3, 0.5, 1.0]))
def test_the_noise_figure_asked_for_is_the_one_of_random_noise(problem, target):
    prepared = Greit(noise_figure=target).prepare(problem)
    signal, areas = central_signal(problem), problem.mesh.areas_mm2
    noise = np.random.default_rng(11).standard_normal((4000, len(signal)))
    seen = np.abs(areas * prepared.images(signal[None])[0]).mean()
    rms = np.sqrt(np.mean((areas * prepared.images(noise)) ** 2))
    measured = np.abs(signal).mean() / (seen / rms)
    assert measured == pytest.approx(target, rel=0.02)
    assert prepared.choice.noise_figure == pytest.approx(target, rel=2e-3)


def test_rows_are_the_weighted_fits_they_claim_to_be(problem):
    """Against a least-squares solver on the stacked system, where far errors were not raised."""
    design = TargetDesign.for_problem(problem, None, None)
    rows = GreitRows(problem, design)
    targets, nodes = rows.targets, problem.mesh.nodes_mm
    at, level = 0.1, np.sqrt((targets.signals**2).mean())
    for node in np.argsort(np.hypot(*nodes.T))[:3]:
        away = np.hypot(*(targets.centres_mm - nodes[node]).T) / (2 * design.head_mm)
        near = np.where(away < 1, (1 - np.minimum(away, 1) ** 4) ** 2, 0.0)
        weight = near + 0.01
        share = 1 / weight.sum()
        system = np.vstack([(targets.signals * np.sqrt(weight * share)).T, at * level * np.eye(len(targets.signals))])
        for column, width in enumerate(WIDTHS):
            wide = targets.target_images(nodes[node][None], (width, 1.0))[0]
            aim = near * wide[:, 0] + 0.01 * wide[:, 1]
            right = np.concatenate([np.sqrt(share / weight) * aim, np.zeros(len(targets.signals))])
            expected = np.linalg.lstsq(system, right)[0]
            found = rows.solve(at)[node, :, column]
            assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)


def test_desired_images_are_as_large_as_their_targets(problem):
    design = TargetDesign.for_problem(problem, None, None)
    targets = make_targets(problem, ReadingFold.from_problem(problem), design)
    integral = node_areas_mm2(problem.mesh) @ targets.target_images(problem.mesh.nodes_mm)
    assert np.allclose(integral, 1, rtol=1e-12)
    at = np.flatnonzero(targets.of_head)[0]
    x, y = targets.centres_mm[at]
    peak, outline = targets.target_images(np.array([[x, y], [x + design.head_mm, y]]))[:, at]
    assert outline / peak == pytest.approx(0.85, rel=1e-12)


@pytest.mark.rest
def test_a_wider_head_makes_wider_regions(fine, truth):
    change = (truth[1] - truth[0])[:, fine.used]
    areas = []
    for diameter in (13.0, 18.0):
        prepared = Greit(indenter_diameter_mm=diameter).prepare(fine)
        areas.append(
            [
                nearest_blob(contour_regions(Image(fine.mesh, values), 0.85), x, y).area_mm2
                for values, (x, y) in zip(prepared.images(change), NINE_LOCATIONS_MM, strict=True)
            ]
        )
    grown = np.array(areas[1]) / np.array(areas[0])
    assert grown.min() > 1.2
    assert np.median(grown) == pytest.approx((18 / 13) ** 2, rel=0.2)


def test_what_was_made_is_kept_and_does_not_pass_for_another_problem(problem):
    first, again = (Greit(hyperparameter=0.1).prepare(problem).matrix for _ in range(2))
    assert np.shares_memory(first, again)
    louder = replace(problem, noise_variance=np.linspace(1, 9, len(problem.reference)))
    assert not np.allclose(first, Greit(hyperparameter=0.1).prepare(louder).matrix, rtol=1e-3)
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1


@pytest.mark.rest
def test_no_weights_are_those_of_equal_noise_in_any_unit(problem):
    plain = Greit(hyperparameter=0.1).prepare(problem).matrix
    for variance in (1e-12, 1.0, 7e5):
        equal = replace(problem, noise_variance=np.full(len(problem.reference), variance))
        found = Greit(hyperparameter=0.1).prepare(equal).matrix
        assert np.linalg.norm(found - plain) < 1e-6 * np.linalg.norm(plain)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"noise_figure": 0.5, "hyperparameter": 0.1}, ConfigError, "not both"),
        ({"noise_figure": 4000.0}, NumericsError, "cannot be reached"),
        ({"noise_figure": -1.0}, ConfigError, "noise_figure is -1.0"),
        ({"hyperparameter": 0}, NumericsError, "too small: the targets do not determine"),
        ({"hyperparameter": 1e-30}, NumericsError, "too small: the targets do not determine"),
        ({"hyperparameter": 1e-6}, NumericsError, "give a hyperparameter above 1"),
        ({"indenter_diameter_mm": 1e-9}, NumericsError, "diameter of at least 8.8 mm"),
        ({"indenter_diameter_mm": 8.5}, NumericsError, "not resolved by image elements of 5.9 mm"),
        ({"target_diameters_mm": [13.0, 1e-9]}, NumericsError, "diameters of at least 1.3 mm"),
        ({"indenter_diameter_mm": 0.0}, ConfigError, "above 0"),
        ({"indenter_diameter_mm": 80.0}, NumericsError, "up to 50 mm"),
        ({"target_diameters_mm": []}, ConfigError, "at least 1 item"),
        ({"target_diameters_mm": [8.0, -1.0]}, ConfigError, r"\[2\] is -1.0"),
    ],
)
def test_what_makes_no_image_is_refused(problem, options, error, said):
    with pytest.raises(error, match=said):
        Greit(**options).prepare(problem)
