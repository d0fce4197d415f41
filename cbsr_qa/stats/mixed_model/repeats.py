"""Repeated runs of a sensor at one station: where sensors respond to stations differently, their mean counts.

The model has a variance between sensors and one between runs. If a sensor reads differently at another station
than in another run at the same one (sensor and station interact), two runs at one station tell less about stations
than the model assumes. Then the mean of a sensor's runs at a station replaces them: with equal numbers of runs the
restricted likelihood is that of the model with the interaction.
"""

import numpy as np
from scipy import stats

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import Crossing
from cbsr_qa.stats.mixed_model.reml import random_effect_sums

#: Significance level of the F test of the interaction.
LEVEL = 0.05


def average_repeats(design: Crossing, values: Array) -> tuple[Crossing, Array] | None:
    """Average the runs of each sensor at each station, if sensors and stations interact.

    Parameters
    ----------
    values : (N,) one for each run, none missing.

    Returns
    -------
    The design and values (M,) of the means; None where runs may count one by one.
    """
    # A visit: the runs of a sensor at a station, in a group.
    keys = (design.group * len(design.stations) + design.station) * len(design.sensors) + design.sensor
    _, first_runs, visit, counts = np.unique(keys, return_index=True, return_inverse=True, return_counts=True)
    visits = len(first_runs)
    if visits == len(values) or visits == len(design.sensors):
        return None
    means = np.bincount(visit, values) / counts
    run_squares = float(np.sum((values - means[visit]) ** 2))
    sums = random_effect_sums(design.columns(), values, design.sensor)
    run_freedom = len(values) - visits
    visit_freedom = visits - len(design.sensors) - sums.within_rank()
    if visit_freedom < 1:
        return None
    visit_squares = max(sums.within_rest() - run_squares, 0.0)
    if run_squares * stats.f.isf(LEVEL, visit_freedom, run_freedom) >= visit_squares / visit_freedom * run_freedom:
        return None
    return design.select_runs(first_runs.astype(np.intp)), means
