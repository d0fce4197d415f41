"""Standard errors of mean errors, by resampling the presses that were located and the draws that were learned from.

All draws of a recording come from one table. With other presses of the same sheet to learn from and to locate, mean
errors would be others, those of all numbers of presses together, as far as they locate the same presses. Located
presses are resampled by weights (Bayesian bootstrap: Rubin 1981, doi:10.1214/aos/1176345338). The scatter of draws is
common to all numbers: the logarithm of an error after n presses has a variance of τ²/n, as that of a mean of n values
has, so that a number with a single draw has a standard error too.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.studies.frontier.presses.law import LearningCurve
from cbsr_qa.studies.frontier.presses.trial import Trial

#: Number of resamples: a standard error is then known to 3 %.
_RESAMPLES: Final = 500
#: Iterations of the weights of the scatter of draws; they hardly change it after the second.
_ITERATIONS: Final = 4


def resample_errors(trials_by_number: Mapping[int, Sequence[Trial]], visits: Indices) -> LearningCurve | None:
    """Return mean errors against numbers of presses, with their covariance; None if no number has several draws.

    Parameters
    ----------
    visits : (N,) number of the place of each press of the table; presses at one place are resampled together.
    """
    numbers = sorted(trials_by_number)
    degrees = sum(len(trials_by_number[number]) - 1 for number in numbers)
    errors = [float(np.mean([trial.error_mm.mean() for trial in trials_by_number[number]])) for number in numbers]
    if degrees < 1 or min(errors) <= 0:
        return None
    random = np.random.default_rng([*b"resampled presses"])
    weights = random.standard_exponential((_RESAMPLES, int(visits.max()) + 1))[:, visits]
    resampled = [
        np.mean([_weigh(trial, weights) for trial in trials_by_number[number]], axis=0) for number in numbers
    ]
    covariance = np.atleast_2d(np.cov(np.log(resampled), ddof=1))
    learned_share = np.array(numbers) / len(visits)  # of presses that two draws have in common
    draws = np.array([len(trials_by_number[number]) for number in numbers])
    shares = learned_share + (1 - learned_share) / draws
    covariance += np.diag(_draw_variance(trials_by_number, len(visits)) / np.array(numbers) * shares)
    return LearningCurve(np.array(numbers, dtype=float), np.array(errors), covariance, degrees)


def _weigh(trial: Trial, weights: Array) -> Array:
    """Return the mean error of a draw with the weights (b, N) of each resample."""
    own = weights[:, trial.located]
    return np.asarray(own @ trial.error_mm / own.sum(axis=1), dtype=np.float64)


def _draw_variance(trials_by_number: Mapping[int, Sequence[Trial]], total: int) -> float:
    """Return τ², the variance of the logarithm of a draw's error times the number n that it learned from.

    Draws of n out of N presses have n/N of them in common on average, so that they scatter about each other by
    τ² (1 − n/N)/n, and by v, what the presses that they locate contribute. Numbers count by how well they determine
    τ²: the variance of k draws has a relative error of √(2/(k − 1)).
    """
    several = {number: trials for number, trials in trials_by_number.items() if len(trials) > 1}
    numbers = np.array(list(several), dtype=float)
    means = [np.array([trial.error_mm.mean() for trial in trials]) for trials in several.values()]
    located = [
        np.array([trial.error_mm.var() / (len(trial.error_mm) - 1) for trial in trials])
        for trials in several.values()
    ]
    located_variance = np.array([np.mean(own / mean**2) for own, mean in zip(located, means, strict=True)])
    excess = np.array([np.log(mean).var(ddof=1) for mean in means]) - located_variance
    share = (1 - numbers / total) / numbers
    degrees = np.array([len(mean) - 1 for mean in means])
    variance = 1.0
    for _ in range(_ITERATIONS):
        weights = degrees / (located_variance + share * variance) ** 2
        variance = max(0.0, float(weights @ (share * excess) / (weights @ share**2)))
    return variance
