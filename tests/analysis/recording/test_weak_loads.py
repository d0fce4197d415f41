"""Loads beside others in one change, by the forward model: a weak one is found when the strong ones are taken out."""

import numpy as np
import pytest
from pressed_files import DISC

from cbsr_qa.analysis.recording.imaging import sheet_for, unit_model
from cbsr_qa.analysis.recording.places import _span_surroundings, find_places, matcher
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.inverse.problem import nominal_model
from cbsr_qa.eit.loads.local import LocalUpdate

USED = DISC.pattern.usable()
STRONG, SCENES = -0.3, 12


@pytest.fixture(scope="module")
def pressed():
    """Changes of three loads a scene, 0.6 radii apart or more, the third of a share of the strength of the others."""
    model = LocalUpdate(nominal_model(DISC))
    empty = model.model.voltages()
    made = {}

    def scene(seed, shares):
        if (seed, shares) not in made:
            rng = np.random.default_rng([61, seed])
            apart, places = 0.0, np.zeros((3, 2))
            while apart < 0.6:
                angle, r = rng.uniform(0, 2 * np.pi, 3), 0.75 * np.sqrt(rng.uniform(0, 1, 3))
                places = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
                apart = np.hypot(*(places - np.roll(places, 1, axis=0)).T).min()
            change = np.zeros(len(model.model.mesh.elements))
            for (x, y), share in zip(places, shares, strict=False):
                elements, covered = disc_coverage(model.model.mesh, 50 * x, 50 * y, 6.5)
                change[elements] += STRONG * share * covered
            changed = np.flatnonzero(change)
            made[seed, shares] = places[: len(shares)], (model.voltages(changed, change[changed]) - empty)[USED]
        return made[seed, shares]

    return empty[USED], scene


def found(reference, scenes, noise):
    """How often every load is found within 0.15 radii, and how often one is named further than 0.25 from all."""
    sheet = sheet_for(DISC, USED)
    sigma = noise * np.abs(reference).max()
    nuisance = unit_model(reference, sheet.problem, offset=True).nuisance
    match = matcher(sheet.patterns, sheet.places, np.full(len(reference), sigma), nuisance)
    all_of, others = 0, 0
    for seed, (places, change) in enumerate(scenes):
        noisy = change + sigma * np.random.default_rng([62, seed]).normal(size=len(change))
        named = np.array([(place.x, place.y) for place in find_places(match.whiten(noisy[None])[0], match)[0]])
        away = np.hypot(*(places[:, None] - named[None]).transpose(2, 0, 1))
        all_of += bool((away.min(axis=1) < 0.15).all())
        others += bool((away.min(axis=0) > 0.25).any())
    return all_of, others


@pytest.mark.parametrize(
    ("shares", "noise", "at_least"),
    [((1.0,), 1e-3, SCENES), ((1.0, 1.0), 1e-3, 10), ((1.0, 1.0, 0.5), 1e-3, 9), ((1.0, 1.0, 0.2), 1e-3, 4)],
)
def test_loads_beside_stronger_ones_are_found_and_no_others(pressed, shares, noise, at_least):
    reference, scene = pressed
    all_of, others = found(reference, [scene(seed, shares) for seed in range(SCENES)], noise)
    assert others == 0
    assert all_of >= at_least


def test_noise_beside_two_loads_is_no_third(pressed):
    reference, scene = pressed
    scenes = [scene(seed % SCENES, (1.0, 1.0)) for seed in range(10 * SCENES)]
    assert found(reference, scenes, 3e-3)[1] == 0


def test_what_is_taken_out_with_a_load_lies_about_its_place():
    sheet = sheet_for(DISC, USED)
    match = matcher(sheet.patterns, sheet.places, np.ones(len(sheet.patterns)), np.ones(len(sheet.patterns)))
    index = int(np.argmin(np.hypot(*(match.places - (0.6, 0.2)).T)))
    basis = _span_surroundings(match, index)
    left = np.linalg.norm(match.patterns - basis @ (basis.T @ match.patterns), axis=0)
    away = np.hypot(*(match.places - match.places[index]).T)
    assert left[away < 0.1].max() < 0.1
    assert left[away > 0.8].min() > 0.7
