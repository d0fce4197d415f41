"""Material files with the relaxation of a strip: written, read, kept with a run, and refused where it cannot be."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.config.material import material_text
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import MeasuredKernel, StripRelaxation
from cbsr_qa.store.runs.codec import decode_material, encode_setting

TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), min_size=1, max_size=40)


def _kernel(*weights, stderr=0.02, correlation=0.3):
    size = 2 * len(weights)
    covariance = stderr**2 * (correlation + (1 - correlation) * np.eye(size))
    taus = tuple(2.5 * 9.0**k for k in range(len(weights)))
    return MeasuredKernel(weights, taus, tuple(map(tuple, covariance.tolist())), 0.5, 59.5)


STRIPS = st.builds(
    lambda loading, unloading, cycles, strains, source: StripRelaxation(
        loading, unloading, cycles, min(strains), max(strains), source
    ),
    st.none() | st.builds(_kernel, st.floats(-2, 2), st.floats(-2, 2)),
    st.none() | st.builds(_kernel, st.floats(-2, 2)),
    st.integers(1, 10_000),
    st.tuples(st.floats(1e-3, 0.9), st.floats(1e-3, 0.9)),
    TEXTS,
)


@given(STRIPS)
def test_a_strips_relaxation_is_read_back_as_it_was(tmp_path_factory, strip):
    material = replace(load_material("cbsr-8wt").value, strip_relaxation=strip)
    path = tmp_path_factory.mktemp("material") / "one.toml"
    path.write_text(material_text(material), encoding="utf-8")
    assert load_material(path).value == material
    sensor = load_sensor_type("strip-40x20mm").value
    kept = json.loads(json.dumps(encode_setting(sensor, Indenter(13.0), material)))
    assert decode_material(kept) == material


def test_materials_without_one_are_read_and_kept_as_before():
    material = load_material("cbsr-8wt").value
    assert material.strip_relaxation is None
    assert "strip_relaxation" not in material_text(material)
    kept = encode_setting(load_sensor_type("strip-40x20mm").value, Indenter(13.0), material)
    assert "strip_relaxation" not in kept["material"]
    assert decode_material(kept) == material


def _changed(**changes):
    return replace(_kernel(-0.2, -0.5), **changes)


@pytest.mark.parametrize(
    ("kernel", "key", "said"),
    [
        (_changed(time_constants_s=(2.5,)), "time_constants_s", "has 1 numbers, weights 2"),
        (_changed(time_constants_s=(2.5, -1.0)), "time_constants_s[2]", "above 0"),
        (_changed(covariance=((1.0, 0.0), (0.0, 1.0))), "covariance", "4 rows of 4 numbers"),
        (_changed(covariance=tuple(map(tuple, np.triu(np.ones((4, 4))).tolist()))), "covariance", "symmetric"),
        (_kernel(-0.2, -0.5, correlation=-0.6), "covariance", "a variance would be negative"),
        (_changed(covariance=tuple(map(tuple, (-np.eye(4)).tolist()))), "covariance", "a variance would be negative"),
        (_changed(start_s=60.0), "start_s", "must be below window_s, 59.5 s"),
        (_changed(weights=(np.inf, 0.1)), "weights[1]", "is not a finite number"),
    ],
)
def test_a_kernel_that_nothing_can_have_is_refused(tmp_path, kernel, key, said):
    strip = StripRelaxation(None, kernel, 3, 0.1, 0.3, "a test")
    path = tmp_path / "one.toml"
    path.write_text(material_text(replace(load_material("cbsr-8wt").value, strip_relaxation=strip)), encoding="utf-8")
    with pytest.raises(ConfigError, match=re.escape(f"material.strip_relaxation.unloading.{key}")) as caught:
        load_material(path)
    assert said in str(caught.value)


def test_strains_the_wrong_way_round_are_refused(tmp_path):
    strip = StripRelaxation(None, _kernel(0.5), 3, 0.3, 0.1, "a test")
    path = tmp_path / "one.toml"
    path.write_text(material_text(replace(load_material("cbsr-8wt").value, strip_relaxation=strip)), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"least_strain is 0\.3, above largest_strain, 0\.1"):
        load_material(path)
