"""Each sensor of a batch by the others: whether it is like them, and its map."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood
from cbsr_qa.calibration.batch.loads import BatchLoads
from cbsr_qa.calibration.batch.model import BatchModel, thin
from cbsr_qa.calibration.batch.posterior import Posterior, find_posterior
from cbsr_qa.calibration.batch.prior import DRAWS, BatchPrior, Likeness
from cbsr_qa.calibration.batch.sensor_map import BatchMap
from cbsr_qa.domain.numbers import Array

#: Members of a prior by the others, and draws of a test for each sensor of the batch.
_MEMBERS: Final = 64
_DRAWS_PER_SENSOR: Final = 40
#: Effective share of the batch's hyperparameters below which those of the others are found anew: a sensor so unlike
#: the others has changed what all look like.
_FEW: Final = 0.05


def leave_each_out(
    model: BatchModel, count: Callable[[int, int], None] = lambda done, of: None
) -> Iterator[tuple[Likeness, BatchMap]]:
    """Yield for each sensor how like the others it is, and its map by the others' and its own loads.

    The weights of hyperparameters are those of the other sensors alone.

    Parameters
    ----------
    count : called with the number of sensors done, and of all.
    """
    sensors = model.loads.sensors
    draws = max(DRAWS, _DRAWS_PER_SENSOR * len(sensors) - 1)  # p values that are adjusted for all sensors
    for number, (sensor, (others, posterior)) in enumerate(zip(sensors, find_posteriors(model), strict=True)):
        prior = BatchPrior(others, *thin(posterior, _MEMBERS))
        count(number + 1, len(sensors))
        yield prior.test_likeness(sensor, draws), prior.learn_response(sensor)


def find_posteriors(model: BatchModel) -> Iterator[tuple[BatchLikelihood, Posterior]]:
    """Yield for each sensor the likelihood and the posterior of the others alone."""
    sensors = model.loads.sensors
    together = BatchLikelihood(model.loads).compute(model.posterior.choices)
    for number in range(len(sensors)):
        others = BatchLikelihood(BatchLoads(sensors[:number] + sensors[number + 1 :]))
        posterior = _reweigh(model.posterior, others, together)
        if 1 / (posterior.weights**2).sum() < _FEW / (model.posterior.weights**2).sum():
            posterior = find_posterior(others, model.radius_mm)
        yield others, posterior


def _reweigh(posterior: Posterior, others: BatchLikelihood, together: Array) -> Posterior:
    log_weights = np.log(posterior.weights) + others.compute(posterior.choices) - together
    weights = np.exp(log_weights - log_weights.max())
    return replace(posterior, weights=weights / weights.sum())
