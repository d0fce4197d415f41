"""The shipped materials' reading noise, imaged as the shipped recipe images it, is the paper's image noise floor."""

import numpy as np
import pytest

from cbsr_qa.config.loader import load_material, load_recipe, load_sensor_type
from cbsr_qa.eit.imaging.blobs import noise_floor
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind


@pytest.mark.parametrize(("material", "printed"), [("cbsr-8wt", 5.97e-3), ("cbsr-9wt", 1.53e-3)])
def test_image_noise_floor_is_the_papers(material, printed):
    recipe = load_recipe("nine-locations").value
    factory = discover().factory(Kind.RECONSTRUCTION, recipe.reconstruction.name)
    problem = imaging_problem(load_sensor_type("disc-100mm").value)
    matrix = factory(**recipe.reconstruction.options).prepare(problem).matrix
    rms = load_material(material).value.relative_noise.value * np.abs(problem.reference).mean()
    unloaded = next(phase for phase in recipe.phases if "frames" in phase.options).options["frames"]
    first = recipe.analysis.noise_floor_frames

    random = np.random.default_rng(1)
    floors = []
    for _ in range(200):
        frames = rms * random.normal(size=(unloaded, len(problem.reference)))
        images = (frames[:first] - frames[first:].mean(axis=0)) @ matrix.T
        floors.append(noise_floor(images))
    # 200 floors with a spread of 12 % give their mean to 1 %.
    assert np.mean(floors) == pytest.approx(printed, rel=0.03)
