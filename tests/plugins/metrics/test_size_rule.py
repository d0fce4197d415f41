"""The overlap is never judged without the size: a sheet-wide blob and a speck must fail the shipped recipe."""

from importlib.resources import files

import numpy as np
import pytest
from observation_samples import sample_load, sample_run

from cbsr_qa.analysis.evaluate import judge
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import decide
from cbsr_qa.plugin.discovery import discover
from cbsr_qa_plugins.metrics.location import AreaOverlap

_SHIPPED = files("cbsr_qa._stations").joinpath("recipes", "nine-locations.toml").read_text()
_OVERLAP = '[[limits]]\nmeasurement = "area_overlap"\nunit = "%"\nlower = 50.0\n'
_RATIO = '[[limits]]\nmeasurement = "area_ratio"\nunit = "1"\n'


def _verdict(blob_mm):
    load = sample_load(blob_mm=blob_mm)
    measured = AreaOverlap().measure_load(load, sample_run((load,)))
    limits = [
        x for x in load_recipe("nine-locations").value.limits if x.measurement in ("area_overlap", "area_ratio")
    ]
    judged = judge(measured, limits)
    overlap = next(m for m in judged if m.name == "area_overlap" and not m.qualifier)
    return overlap, decide(judged)


@pytest.mark.parametrize(
    ("radius_mm", "ratio"), [(50.0, 59.2), (6.5 * np.sqrt(0.029), 0.029)], ids=["whole sheet", "speck"]
)
def test_a_blob_of_senseless_size_fails_although_its_overlap_is_enough(radius_mm, ratio):
    overlap, verdict = _verdict((0.0, 0.0, radius_mm))
    assert overlap.value == pytest.approx(50 * (min(ratio, 1.0) + min(1 / ratio, 1.0)), abs=0.05)
    assert overlap.outcome is not Outcome.FAIL
    assert verdict.outcome is Outcome.FAIL
    assert verdict.reason.startswith("area ratio (L0) is")


def test_a_blob_like_the_head_passes_both():
    assert _verdict((1.0, 0.0, 6.5))[1].outcome is Outcome.PASS


def _loaded(tmp_path, limits):
    head, _, rest = _SHIPPED.partition("[[limits]]")
    path = tmp_path / "recipe.toml"
    path.write_text(head + limits)
    assert rest
    return load_recipe(path, discover()).value


@pytest.mark.parametrize(
    ("limits", "missing"),
    [
        (_OVERLAP + 'phase = "nine locations"\n', "nine locations"),
        (_OVERLAP + 'phase = "nine locations"\n' + _RATIO + 'lower = 0.3\nupper = 3.0\nphase = "random loads"\n',
         "nine locations"),
        (_OVERLAP + 'phase = "nine locations"\n' + _RATIO + "upper = 3.0\n", "nine locations"),
        (_OVERLAP + 'phase = "nine locations"\n' + _RATIO + "lower = -0.1\nupper = 3.0\n", "nine locations"),
        (_OVERLAP + _RATIO + 'lower = 0.3\nupper = 3.0\nphase = "nine locations"\n', "random loads"),
    ],
    ids=["none", "another phase", "one side", "below nothing", "one phase of all"],
)  # fmt: skip
def test_a_recipe_that_limits_the_overlap_without_the_size_is_refused(tmp_path, limits, missing):
    with pytest.raises(ConfigError) as caught:
        _loaded(tmp_path, limits)
    said = str(caught.value)
    assert f"limits[1] (area_overlap) judges phase '{missing}'" in said
    assert "overlaps by about 51 %" in said
    assert "limit area_ratio there too" in said


@pytest.mark.parametrize("phase", ["", 'phase = "nine locations"\n'])
def test_a_limit_of_the_size_there_or_everywhere_is_enough(tmp_path, phase):
    ratio = _RATIO + "lower = 0.3\nupper = 3.0\n" + phase
    recipe = _loaded(tmp_path, _OVERLAP + 'phase = "nine locations"\n' + ratio)
    assert [limit.measurement for limit in recipe.limits] == ["area_overlap", "area_ratio"]


def test_a_phase_of_loops_has_no_overlap_to_limit(tmp_path):
    phases = ("noise figure", "nine locations", "random loads", "relaxation")
    limits = _OVERLAP + "".join(f'{_RATIO}lower = 0.3\nupper = 3.0\nphase = "{name}"\n' for name in phases)
    loops = '\n[[phases]]\nname = "loops"\nsequence = "hysteresis-loop"\n'
    assert len(_loaded(tmp_path, limits + loops).phases) == 5
    more = '\n[[phases]]\nname = "more"\nsequence = "random-loads"\nstream = "more"\n'
    with pytest.raises(ConfigError, match=r"judges phase 'more', where no limit bounds area_ratio"):
        _loaded(tmp_path, limits + more)
