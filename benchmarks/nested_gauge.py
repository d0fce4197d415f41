"""How often intervals of a nested gauge study hold the truth.

``python -m benchmarks.nested_gauge --studies 2000`` simulates studies of 5 parts of each of 4 appraisers, 2 runs
each, with deviations of appraisers, parts and runs, and prints the share of 95 % intervals that hold, of each
variance and of the gauge's share of the total.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse

import numpy as np

from cbsr_qa.stats.gauge.nested import NestedStudy, nested_anova

#: Deviations of appraisers, parts and runs.
DESIGNS = ((1.0, 2.0, 0.5), (0.3, 1.0, 1.0), (2.0, 0.5, 0.5), (0.0, 1.0, 0.5))
NAMES = ("repeatability", "reproducibility", "gauge", "sensor", "total", "share of the gauge")
_SHAPE = 5, 4, 2


def measure(appraiser: float, part: float, trial: float, studies: int) -> dict[str, float]:
    """Return the share of 95 % intervals that hold, by name."""
    gauge, total = trial**2 + appraiser**2, trial**2 + appraiser**2 + part**2
    truths = trial**2, appraiser**2, gauge, part**2, total
    random, holds = np.random.default_rng(141), []
    p, o, r = _SHAPE
    for _ in range(studies):
        values = (
            appraiser * random.normal(size=(1, o, 1))
            + part * random.normal(size=(p, o, 1))
            + trial * random.normal(size=(p, o, r))
        )
        names = tuple(map(str, range(p * o)))
        found = nested_anova(NestedStudy(values, names, names[:o]))
        held = []
        for name, truth in zip(NAMES, truths, strict=False):
            interval = getattr(found.components, name).variance_interval
            held.append(interval.holds(truth))
        held.append(found.gauge_percent_contribution_interval.holds(100 * gauge / total))
        holds.append(held)
    return dict(zip(NAMES, np.mean(holds, axis=0).tolist(), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=2000)
    studies = parser.parse_args().studies
    print("deviations of appraisers, parts, runs:", ", ".join(NAMES))
    for design in DESIGNS:
        shares = measure(*design, studies)
        print(*design, ": ", ", ".join(f"{share:.1%}" for share in shares.values()), sep=" ")


if __name__ == "__main__":
    main()
