"""How often intervals of Ppk and of the nonconforming share by a fitted family hold the truth.

``python -m benchmarks.fitted_capability --samples 1000`` draws samples of each family, with an upper limit at a true
Ppk of 1, and prints the share of 95 % intervals that hold: of Ppk and of the parts per million where the family is
named, of Ppk where it is chosen by AIC (and how often the true one is), and of Ppk by percentiles, which leaves the
family open. ``--sides 2`` adds a lower limit at the same index.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from dataclasses import dataclass

import numpy as np

from cbsr_qa.stats.fitted_capability import BEST, fitted_capability
from cbsr_qa.stats.fitted_families import FAMILIES
from cbsr_qa.stats.percentile_capability import SHARES, percentile_index
from cbsr_qa.stats.process_capability import Index

#: Name of each family and its parameters.
TRUTHS: dict[str, tuple[float, ...]] = {
    "normal": (10.0, 1.0),
    "log-normal": (0.0, 0.5),
    "weibull": (0.0, 1 / 1.7),
    "gamma": (4.0, 0.5),
    "log-logistic": (0.0, 0.2),
    "logistic": (10.0, 1.0),
    "largest-extreme-value": (10.0, 1.0),
    "smallest-extreme-value": (10.0, 1.0),
    "3-parameter-log-normal": (0.0, 0.5, 10.0),
    "3-parameter-weibull": (0.0, 1 / 1.7, 10.0),
}


@dataclass(frozen=True)
class Coverage:
    """Shares of 95 % intervals that hold, and of samples whose true family is chosen."""

    ppk: float
    ppm: float
    ppk_chosen: float
    right: float
    ppk_open: float


def measure(name: str, count: int, samples: int, sides: int = 1, *, others: bool = True) -> Coverage:
    """Draw samples of a family and return what holds; the last three are NaN without ``others``."""
    family, truth = FAMILIES[name], np.array(TRUTHS[name])[:, None]
    least, _, upper = (float(family.quantile(truth, share)[0]) for share in SHARES)
    limits = {"lower": least if sides == 2 else None, "upper": upper, "confidence": 0.95}
    ppm, random = 1e6 * (SHARES[0] * sides), np.random.default_rng([2251, count])
    holds = np.full((samples, 5), np.nan)
    for sample in holds:
        values = family.quantile(truth, random.random((1, count)))
        found = fitted_capability(values, name, **limits)
        sample[:2] = _hold(found.ppk, 1.0), found.ppm.low <= ppm <= found.ppm.high
        if others:
            chosen = fitted_capability(values, BEST, **limits)
            averaged = percentile_index(values, **limits)
            assert isinstance(averaged, Index)
            sample[2:] = _hold(chosen.ppk, 1.0), chosen.fit.family == name, _hold(averaged, 1.0)
    return Coverage(*holds.mean(axis=0))


def _hold(index: Index, truth: float) -> bool:
    return index.low <= truth <= index.high


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1000)
    parser.add_argument("--sides", type=int, choices=(1, 2), default=1)
    parser.add_argument("--counts", type=int, nargs="+", default=[30, 100])
    options = parser.parse_args()
    print("family, values: Ppk and ppm of the named family; Ppk of the chosen one (share right); Ppk, family open")
    for name in TRUTHS:
        for count in options.counts:
            row = measure(name, count, options.samples, options.sides)
            named, chosen = f"{row.ppk:.1%} {row.ppm:.1%}", f"{row.ppk_chosen:.1%} ({row.right:.0%})"
            print(f"{name}, {count}: {named}; {chosen}; {row.ppk_open:.1%}", flush=True)


if __name__ == "__main__":
    main()
