"""Every built-in effect: what it says of itself, and that parameters which make no sense are refused by name."""

import inspect
import math
import re
from typing import Any

import pytest
from simulated_setting import HEAD, installed, material, sensor_type

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import PluginChoice, Scene, SceneSetting
from cbsr_qa.plugin import Kind
from cbsr_qa.simulate.chain import STAGES, build_chain
from cbsr_qa_plugins.registry import BUILT_IN

SETTING = SceneSetting(sensor_type(), material(), HEAD, seed=1, current_A=1e-3)
EFFECTS = [name for kind, name, _ in BUILT_IN if kind is Kind.EFFECT]

#: What an effect cannot do without; a parameter that has a default needs no line here.
REQUIRED: dict[str, dict[str, Any]] = {
    "sheet-seat": {"error_mm": 0.1},
    "load-cell-noise": {"rms_N": 0.01},
    "unloading-spike": {"size": 0.2, "decay_s": 1.0},
    "residue": {"share": 0.1, "decay_s": 100.0},
    "hysteresis": {"width": 0.1},
    "head-edge": {"width_mm": 1.0},
    "pressure-profile": {"shape": "punch"},
    "temperature-drift": {"coefficient_per_K": 0.01},
    "load-cell-saturation": {"limit_N": 7.0},
    "applicator-position-error": {"error_mm": 0.1},
    "backlash": {"play_mm": 0.1},
    "uneven-conductance": {"deviation": 0.1, "correlation_mm": 20.0},
    "uneven-response": {"deviation": 0.1, "correlation_mm": 20.0},
    "uneven-thickness": {"deviation": 0.1, "correlation_mm": 20.0},
    "contact-spread": {"deviation": 0.1},
    "contact-drift": {"deviation_per_hour": 0.1},
    "pin-position-error": {"error_mm": 0.1},
    "reading-memory": {"share": 0.1},
    "mains-hum": {"amplitude_V": 0.01},
    "quantisation": {"range_V": 2.0, "bits": 12},
    "converter-saturation": {"range_V": 2.0},
    "reading-offset": {"offset_V": 0.01},
    "lead-resistance": {"electrode": 3, "resistance_ohm": 100.0},
    "electrode-short": {"electrodes": [3, 9]},
    "electrode-open": {"electrode": 3},
    "electrode-intermittent": {"electrode": 3, "mean_open_s": 1.0, "mean_closed_s": 1.0},
    "frame-loss": {"share": 0.1},
    "watchdog-dump": {"period_s": 60.0},
    "electrode-noise": {"electrode": 3, "relative_noise": 0.01},
}
#: What may be below zero. All else is a length, time, share, deviation, resistance, limit or count.
SIGNED = {"offset_V", "x_mm", "y_mm", "rotation_deg", "coefficient_per_K", "rate_K_per_h", "temperature_C", "bias_A"}
WORDS = {"inner", "shape"}
NO_NUMBERS = [math.nan, math.inf, -math.inf, "5 s", "5", True, [1.0], {}, 1j]


def parameters(name: str) -> list[str]:
    return list(inspect.signature(installed(name)).parameters)[1:]


ALL = [(name, parameter) for name in EFFECTS for parameter in parameters(name)]
NUMBERS = [(name, parameter) for name, parameter in ALL if parameter not in WORDS]


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


@pytest.mark.parametrize(("name", "parameter"), NUMBERS)
def test_what_is_no_finite_number_is_refused_by_effect_and_parameter(name: str, parameter: str):
    for value in NO_NUMBERS:
        error = refused(name, **{parameter: value})
        assert f": {parameter} is {value!r}" in error.reason
        assert re.match(r"it must be a (finite|whole) number|electrodes are numbered|it is a list", error.remedy)


@pytest.mark.parametrize(("name", "parameter"), NUMBERS)
def test_a_whole_number_beyond_all_floats_is_refused(name: str, parameter: str):
    for digits in (400, 6000):
        assert f"{parameter} is a whole number beyond 1.8e308" in refused(name, **{parameter: 10**digits}).reason


@pytest.mark.parametrize(("name", "parameter"), [(n, p) for n, p in NUMBERS if p not in SIGNED])
def test_what_cannot_be_negative_is_refused_below_zero(name: str, parameter: str):
    for value in (-1e-9, -1, -1e300):
        given = [3, value] if parameter == "electrodes" else value
        assert parameter in refused(name, **{parameter: given}).reason


@pytest.mark.parametrize(("name", "parameter"), [(n, p) for n, p in ALL if p in WORDS])
def test_a_word_that_is_none_of_the_known_is_refused(name: str, parameter: str):
    for value in ("outer", "", 3, True, ["punch"]):
        error = refused(name, **{parameter: value})
        assert f"{parameter} is {value!r}" in error.reason
        assert "'" in error.remedy


@pytest.mark.parametrize("name", [name for name in EFFECTS if parameters(name)])
def test_a_parameter_it_does_not_have_is_refused_with_those_it_has(name: str):
    error = refused(name, phase_of_the_moon=1.0)
    assert "has no parameter 'phase_of_the_moon'" in error.reason
    assert all(parameter in error.remedy for parameter in parameters(name))


#: A unit that is not the parameter's own, by its own.
OTHER_UNITS = {
    "s": "ms",
    "ms": "s",
    "mm": "m",
    "V": "mV",
    "N": "g",
    "A": "mA",
    "ohm": "kohm",
    "Hz": "kHz",
    "C": "K",
    "K": "C",
}


def with_unit(parameter: str) -> str | None:
    stem, _, unit = parameter.rpartition("_")
    return f"{stem}_{OTHER_UNITS[unit]}" if stem and unit in OTHER_UNITS else None


@pytest.mark.parametrize(("name", "parameter"), [(n, p) for n, p in ALL if with_unit(p)])
def test_a_parameter_in_another_unit_is_refused_with_the_nearest(name: str, parameter: str):
    asked = with_unit(parameter)
    error = refused(name, **{asked: 1.0})
    assert f"has no parameter {asked!r}" in error.reason
    assert f"did you mean {parameter!r}?" in error.remedy


@pytest.mark.parametrize("name", [name for name in EFFECTS if not parameters(name)])
def test_an_effect_without_parameters_says_so(name: str):
    assert refused(name, decay_ms=1.0).remedy == "it takes no parameters"


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
