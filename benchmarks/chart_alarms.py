"""How often charts of a station that is well signal, and how soon a lasting shift is found; prints a table.

    python -m benchmarks.chart_alarms

Normal values of deviation 1, a reference of 30 or 100 runs, and the signals at the end of each run after it.
"""

import numpy as np

from cbsr_qa.domain.results.charts import ChartKind, ChartSettings
from cbsr_qa.studies.charts.charting import STANDS, UNCOUNTED, charts_of, standard_of

SERIES = 150
CHARTS = {
    "i-mr, rules 1, 2": ChartSettings(),
    "i-mr, rule 1": ChartSettings(rules=(1,)),
    "i-mr, rules 1 to 8": ChartSettings(rules=tuple(range(1, 9))),
    "ewma": ChartSettings(ChartKind.EWMA),
    "cusum": ChartSettings(ChartKind.CUSUM),
}


def told(settings, reference, runs, shift, random):
    """Whether a signal stands after each run of one series, (runs,) bool."""
    values = random.standard_normal(reference + runs)
    values[reference:] += shift
    limits = standard_of(list(values[:reference]), settings, "reference")
    stands = np.zeros(runs, dtype=bool)
    for one in charts_of(list(values[reference:]), settings, limits):
        if one.chart.name != UNCOUNTED:
            for signal in one.chart.signals:
                stands[one.ends[signal.index] :][:STANDS] = True
    return stands


def main():
    random = np.random.default_rng(20261122)
    for reference in (30, 100):
        for name, settings in CHARTS.items():
            false = np.mean([told(settings, reference, 300, 0.0, random) for _ in range(SERIES)])
            after = []
            for shift in (1.0, 2.0):
                found = [told(settings, reference, 300, shift, random) for _ in range(SERIES)]
                after.append(np.median([np.argmax(one) + 1 if one.any() else np.inf for one in found]))
            print(
                f"{reference:4d} runs  {name:20s} false {100 * false:4.1f} %  found after {after[0]:g}, {after[1]:g}"
            )


if __name__ == "__main__":
    main()
