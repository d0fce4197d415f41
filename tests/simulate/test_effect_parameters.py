"""Every built-in effect: what it says of itself, and that parameters which make no sense are refused by name."""

import math
import re
from typing import Any

import pytest
from effect_options import REQUIRED
from simulated_setting import HEAD, installed, material, sensor_type

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.plan import PluginChoice, Scene
from cbsr_qa.domain.plan.world import SceneSetting
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.options import options_of
from cbsr_qa.simulate.chain import STAGES, build_chain
from cbsr_qa_plugins.registry import BUILT_IN

SETTING = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)
EFFECTS = [name for kind, name, _ in BUILT_IN if kind is Kind.EFFECT]

#: What may be below zero. All else is a length, time, share, deviation, resistance, limit or count.
SIGNED = {"offset_V", "x_mm", "y_mm", "rotation_deg", "coefficient_per_K", "rate_K_per_h", "temperature_C", "bias_A"}


def parameters(name: str) -> list[str]:
    return list(options_of(installed(name), handed=1).model_fields)


def build(name: str, **options: Any) -> None:
    """Make an effect and what it needs, as a scene does."""
    choices: list[PluginChoice] = []
    for need in installed(name).needs:
        choices.append(PluginChoice(need, REQUIRED.get(need, {})))
    choices.append(PluginChoice(name, REQUIRED.get(name, {}) | options))
    build_chain(Scene("t", tuple(choices), 1e-3, 2.5, 5.0, ()), SETTING, installed)


def refused(name: str, **options: Any) -> ConfigError:
    with pytest.raises(ConfigError, match=f"scene 't', effect '{name}'") as caught:
        build(name, **options)
    assert caught.value.remedy
    return caught.value


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_can_be_made_with_what_it_needs(name: str):
    build(name)
    assert installed(name).perturbs in STAGES


@pytest.mark.parametrize("name", [name for name in EFFECTS if parameters(name)])
def test_what_is_no_finite_number_or_cannot_be_negative_is_refused_by_its_key(name: str):
    """What the models refuse is in tests/plugin/test_options.py; here it is that every parameter has its bounds."""
    for parameter in parameters(name):
        values: list[Any] = [math.nan, math.inf, -math.inf, 10**400, True, {}]
        values += [] if parameter in SIGNED else [-1e-9, -1, -1e300]
        for value in values:
            given = [3, value] if parameter == "electrodes" else value
            assert parameter in refused(name, **{parameter: given}).reason


def test_a_parameter_an_effect_does_not_have_is_refused_with_those_it_has():
    error = refused("measurement-noise", relative_nois=0.1)
    assert "relative_nois is not a known key" in error.reason
    assert "did you mean 'relative_noise'?" in error.remedy
    assert refused("elastic-stress", decay_ms=1.0).remedy == "this takes no options"


@pytest.mark.parametrize(
    ("name", "options", "key", "allowed"),
    [
        ("electrode-open", {"electrode": 16}, "electrode", "from 0 to 15"),
        ("electrode-open", {"electrode": 3, "from_s": 5.0, "to_s": 5.0}, "to_s", "above from_s, 5"),
        ("electrode-short", {"electrodes": [3, 3]}, "electrodes", "two different electrodes"),
        ("electrode-short", {"electrodes": [3, 16]}, "electrodes", "from 0 to 15"),
        ("electrode-noise", {"electrode": 99}, "electrode", "from 0 to 15"),
        ("frame-loss", {"most_rows": 17}, "most_rows", "at most 16"),
        ("head-edge", {"width_mm": 13.0}, "width_mm", "at most 12.35"),
        (
            "measurement-noise",
            {"relative_noise": 0.1, "relative_floor": 0.2},
            "relative_floor",
            "at most relative_noise",
        ),
        ("watchdog-dump", {"period_s": 1.0, "pause_ms": 1000.0}, "pause_ms", "a longer period_s"),
        ("reading-memory", {"inner": "outer"}, "inner", "'measure' or 'drive'"),
        ("quantisation", {"bits": 33}, "bits", "from 4 to 32"),
        ("quantisation", {"range_V": 1e308}, "range_V", "at most 1e+15"),
    ],
)
def test_what_does_not_fit_the_scene_or_another_parameter_is_refused_with_what_does(name, options, key, allowed):
    error = refused(name, **options)
    assert f"{key} is " in error.reason
    assert allowed in error.remedy


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_says_in_one_plain_line_what_it_is(name: str):
    effect = installed(name)
    lines = (vars(effect)["__doc__"] or "").split("\n")
    first = lines[0]
    assert first.endswith("."), first
    assert 20 <= len(first) <= 110, first
    assert first[0].isupper(), first
    assert not re.search(r"[=√Σ∫Δα-ω²`]|\(paper", first), first
    assert len(lines) == 1 or not lines[1].strip()
    for parameter in parameters(name):
        described = " ".join(vars(one).get("__doc__") or "" for one in effect.__mro__)
        assert re.search(rf"\b{parameter}\b.*:", described), parameter
