"""What is refused before anything moves: too few unloaded frames."""

from dataclasses import replace

import pytest

from cbsr_qa.app.run.preflight import check_unloaded
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.steps import AcquireFrames, MarkUnloaded, Press
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.testing.bench import example_plan

_RECIPE = load_recipe("nine-locations").value


def _plan(frames):
    return example_plan(
        (MarkUnloaded(), AcquireFrames(frames), Press(Load("L0", 0.0, 0.0, 0.2, 0)), AcquireFrames(50))
    )


def _recipe(**changes):
    return replace(_RECIPE, analysis=replace(_RECIPE.analysis, **changes))


@pytest.mark.parametrize(
    ("frames", "settings", "said"),
    [
        (8, {}, "takes 8 unloaded frames, but analysis.noise_floor_frames and the reference need 9"),
        (8, {"noise_weighting": "measured"}, "noise_floor_frames and the reference need 9"),
        (5, {"noise_weighting": "measured", "noise_floor_frames": 2}, 'noise_weighting = "measured" needs 6'),
    ],
)
def test_too_few_unloaded_frames_are_refused_with_what_needs_them(frames, settings, said):
    with pytest.raises(ConfigError, match=said) as refused:
        check_unloaded(_plan(frames), _recipe(**settings))
    assert "take more unloaded frames" in refused.value.remedy
    assert ("noise_weighting" in refused.value.remedy) == ("needs 6" in said)


@pytest.mark.parametrize(
    ("frames", "settings"),
    [
        (9, {"noise_weighting": "measured"}),
        (6, {"noise_weighting": "measured", "noise_floor_frames": 2}),
        (3, {"noise_floor_frames": 2}),
    ],
)
def test_as_many_as_are_needed_are_enough(frames, settings):
    check_unloaded(_plan(frames), _recipe(**settings))
