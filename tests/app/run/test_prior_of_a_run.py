"""The batch's model that a run takes as prior: found, refused, and stored with the run."""

import json
import os
from dataclasses import asdict, replace

import pytest
from filled_databases import filled
from kept_batches import keep_sample

from cbsr_qa.app.run.batch_model import add_prior
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.merging import read_model_file, restore
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.studies.simulated import configuration_of, copy_shipped


@pytest.fixture(scope="module")
def configuration():
    recipe = copy_shipped(DocumentKind.RECIPE, "adaptive-batch")
    return configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), recipe, seed=1)


@pytest.fixture
def batches(tmp_path, monkeypatch):
    """Writes a model into the folder of batches."""
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    (tmp_path / "batches").mkdir()

    def write(kept):
        path = tmp_path / "batches" / f"{kept.content_sha256[:16]}.json"
        path.write_text(json.dumps(asdict(kept)))
        return path

    return write


DATABASE = "sqlite:///absent.db"
MEASURED = (Measurement("drift", 0.1, "%/min"),)


def test_a_run_holds_the_model_that_it_used(batches, configuration):
    batches(keep_sample())
    with_prior = add_prior(configuration, "41", None, DATABASE)
    assert with_prior.recipe.analysis.batch == keep_sample()
    assert with_prior.digest != configuration.digest
    assert restore(with_prior.canonical).recipe.analysis.batch == keep_sample()


def test_the_model_that_was_learned_last_counts_whatever_it_leaves_out(batches, configuration):
    whole, fewer = keep_sample(), keep_sample(sensors=keep_sample().sensors[:-1])
    for first, last in [(whole, fewer), (fewer, whole)]:
        for number, kept in enumerate((first, last, keep_sample(batch="42"))):
            os.utime(batches(kept), (number, number))
        assert add_prior(configuration, "41", None, DATABASE).recipe.analysis.batch == last


@pytest.mark.parametrize(
    ("changes", "batch", "words"),
    [
        ({}, "43", "no model of batch '43'"),
        ({}, "", "the sensor's batch is not named"),
        ({"sensor_type": "disc-150mm"}, "41", "is of sensor type disc-150mm, and the run of disc-100mm"),
        ({"material": "cbsr-9wt"}, "41", "is of material cbsr-9wt, and the run of cbsr-8wt"),
        ({"head_mm": 8.0}, "41", "is of head 8 mm, and the run of 13 mm"),
    ],
)
def test_a_model_that_does_not_fit_is_refused_before_anything_moves(batches, configuration, changes, batch, words):
    batches(keep_sample(**changes))
    with pytest.raises(RefusedError, match=r"fits this run|not named") as refused:
        add_prior(configuration, batch, None, DATABASE)
    assert words in refused.value.reason


def test_a_model_with_impossible_numbers_is_refused_before_anything_moves(batches, configuration):
    first, *others = keep_sample().sensors
    batches(keep_sample(sensors=(replace(first, variance=tuple(-v for v in first.variance)), *others)))
    with pytest.raises(RefusedError, match=r"cannot be used: a sensor of the batch has no load, or one whose place"):
        add_prior(configuration, "41", None, DATABASE)


def test_a_named_file_of_another_batch_is_refused(batches, configuration):
    path = batches(keep_sample())
    with pytest.raises(RefusedError, match="is of batch 41, and the run of 42"):
        add_prior(configuration, "42", path, DATABASE)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"time_constants_s": (0.0, 21.9)},
            r"relaxation\.stress\.time_constants_s is \(0\.0, 21\.9\); it must",
        ),
        ({"scatter": (4e-4,)}, r"relaxation\.stress is of 2 weights; it must be of as many time constants"),
        ({"loads": 0}, r"relaxation\.stress\.loads is 0"),
        ({"scatter_freedom": -1.0}, r"relaxation\.stress\.scatter_freedom is -1"),
    ],
)
def test_impossible_relaxation_is_refused_before_anything_moves(batches, configuration, changes, words):
    relaxation = keep_sample().relaxation
    batches(keep_sample(relaxation=replace(relaxation, stress=replace(relaxation.stress, **changes))))
    with pytest.raises(RefusedError, match=words):
        add_prior(configuration, "41", None, DATABASE)


@pytest.mark.parametrize(
    ("name", "value"), [("length_mm", 0.0), ("own", -0.1), ("level", 1e300), ("weight", 2.0), ("scatter", -1e-300)]
)
def test_impossible_hyperparameters_are_refused_before_anything_moves(batches, configuration, name, value):
    first, *others = keep_sample().members
    batches(keep_sample(members=(replace(first, **{name: value}), *others)))
    with pytest.raises(RefusedError, match=r"cannot be used: members"):
        add_prior(configuration, "41", None, DATABASE)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"head_mm": "13"}, "head_mm is '13'"),
        ({"radius_mm": True}, "radius_mm is 'True'"),
        ({"level_drift": None}, "level_drift is 'None'"),
    ],
)
def test_a_value_of_another_type_is_named(batches, changes, words):
    path = batches(keep_sample(**changes))
    with pytest.raises(ConfigError, match=words):
        read_model_file(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace('"head_mm": 13.0', '"head_mm": 12.0'), "was changed"),
        (lambda text: text.replace('"layout": 2', '"layout": 7'), "layout 7; this version reads 2"),
        (lambda text: text[: len(text) // 2], "cannot be read"),
        (lambda text: "[]", "layout None"),
    ],
)
def test_a_changed_or_broken_file_is_named(batches, change, words):
    path = batches(keep_sample())
    path.write_text(change(path.read_text()))
    with pytest.raises(ConfigError) as refused:
        read_model_file(path)
    assert words in refused.value.reason
    assert str(path) in refused.value.reason


def test_a_model_older_than_the_drift_of_its_batch_is_refused(batches, configuration, tmp_path):
    drifting = batches(keep_sample(level_drift=0.02))
    database = tmp_path / "runs.db"
    filled(database, [(f"S-{90 + number}", MEASURED, {"batch": "41", "day": number}) for number in range(12)])
    with pytest.raises(
        RefusedError, match=r"changes by \+2.0% from one sensor to the next, and 12 sensors were tested"
    ):
        add_prior(configuration, "41", None, f"sqlite:///{database}")
    drifting.unlink()
    batches(keep_sample())  # without a drift that is shown, age does not matter
    assert add_prior(configuration, "41", None, f"sqlite:///{database}").recipe.analysis.batch == keep_sample()
