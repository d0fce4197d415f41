"""Presses that a target needs: on simulated recordings limits hold as often as they say, and on real skins."""

import numpy as np
import pytest

from benchmarks.press_forecasts import LAWS, RECORDINGS, forecast_skin, judge


@pytest.mark.parametrize(("total", "quick"), RECORDINGS)
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_forecasts_are_right(law, total, quick):
    """Of 150 recordings, 95 % with limits of 95 % are 90 % or more with a probability of 0.99."""
    for target, judged in judge(law, total, quick, 150):
        assert np.mean([one.right for one in judged]) >= 0.9, target
        if target == "below the floor":
            assert np.mean([one.answer == "limits" for one in judged]) <= 0.05


@pytest.mark.parametrize("name", ["no_pattern", "parallel_lines"])
def test_what_900_presses_of_a_skin_reach_is_forecast_from_400(skins, name):
    for forecast in forecast_skin(skins(name).labelled()):
        low_mm, high_mm = forecast.limits_mm
        assert low_mm <= forecast.reached_mm <= high_mm
