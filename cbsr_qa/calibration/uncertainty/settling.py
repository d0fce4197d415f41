"""Budgets of settling times (JCGM 100, 4.2)."""

from math import sqrt

from cbsr_qa.calibration.uncertainty.combination import BudgetInput, combine
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.expanded_force import ExpandedSettling


def evaluate_settling(calibration: Calibration) -> tuple[ExpandedSettling, ...]:
    """Evaluate the uncertainty of the mean settling times of a calibration, by signal and direction.

    A mean over one load, or over loads of which some had not settled (a lower bound), has none and is left out.
    """
    expanded = []
    for summary in calibration.settling:
        if summary.mean_s is None or summary.deviation_s is None or summary.censored or summary.accepted < 2:
            continue
        count = summary.accepted
        source = f"deviation of {summary.deviation_s:.2g} s over {count} loads"
        repeated = BudgetInput("repeatability", "A", summary.deviation_s / sqrt(count), 1.0, source, float(count - 1))
        budget = combine([repeated], not_stated=("clock of the station", "start of the press"))
        expanded.append(ExpandedSettling(summary.signal, summary.loading, summary.mean_s, budget))
    return tuple(expanded)
