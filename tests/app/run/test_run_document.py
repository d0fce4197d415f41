"""What ``run --json`` says of how a run was imaged."""

from dataclasses import replace

import numpy as np
import pytest
from report_samples import sample_run

from cbsr_qa.app.run.outcome import RunOutcome
from cbsr_qa.report.document import json_document


@pytest.fixture(scope="module")
def result():
    return sample_run()


def document(result):
    return json_document(RunOutcome.from_result(result))


def test_the_regularisation_parameter_and_what_chose_it_are_said(result):
    made = result.observation.reconstruction
    imaged = document(result)["reconstruction"]
    assert imaged["name"] == made.method
    assert imaged["parameter"] == {
        "name": made.choice.name,
        "value": made.choice.value,
        "criterion": made.choice.criterion or None,
        "reason": made.choice.how,
        "noise_figure": made.choice.noise_figure,
    }
    assert (imaged["noise_weighting"], imaged["weight_ratio"]) == ("equal", 1.0)
    assert (imaged["readings"], imaged["elements"]) == made.problem.jacobian.shape


def test_measured_weights_have_their_ratio(result):
    run = result.observation
    variance = np.linspace(0.5, 2.0, len(run.reconstruction.problem.reference))
    made = replace(run.reconstruction, problem=replace(run.reconstruction.problem, noise_variance=variance))
    weighed = replace(run, reconstruction=made, settings=replace(run.settings, noise_weighting="measured"))
    imaged = document(replace(result, observation=weighed))["reconstruction"]
    assert (imaged["noise_weighting"], imaged["weight_ratio"]) == ("measured", 4.0)


def test_what_was_not_imaged_has_none(result):
    assert document(replace(result, observation=None))["reconstruction"] is None
