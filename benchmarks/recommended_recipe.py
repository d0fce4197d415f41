"""The recommended recipe against the paper's campaign, on simulated sensors that chose neither of them.

``python -m benchmarks.recommended_recipe --seeds 4001:4007`` calibrates a sensor a seed both ways (20 s of one core
each) and tests both on thirty random loads. The seeds of ``cbsr-qa frontier``, which recommends the recipe, are
others.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import PAPER, Tried, try_ways

Array = NDArray[np.float64]

#: What ``cbsr-qa frontier`` recommends without a target.
RECOMMENDED = Setting(16, hold_s=15.0, rest_s=5.0, predicted=True)
#: Of both errors, place known and place estimated.
FIGURES = {"force_error": "place known", "force_error_found": "place found"}
#: What the recommended recipe's error may be of the campaign's.
_ALLOWED = 1.2


def both_ways(seed: int) -> tuple[Tried, Tried]:
    """Calibrate one sensor by the recommended recipe, and by the paper's campaign."""
    (short,) = try_ways(RECOMMENDED, seed, [("recommended", RECOMMENDED)])
    (paper,) = try_ways(PAPER, seed, [("paper", PAPER)], whole_holds=False)
    return short, paper


def summary(what: str, short: Array, paper: Array) -> Iterator[str]:
    """Means over the sensors (n,) with standard errors, of the two, of their difference, and of their ratio."""
    ratio = short.mean() / paper.mean()
    yield (
        f"{what}: {_mean(short)} N, the paper's {_mean(paper)} N, difference {_mean(short - paper)} N,"
        f" ratio {ratio:.2f} ± {_stderr(short - ratio * paper) / paper.mean():.2f};"
        f" {int((short > _ALLOWED * paper).sum())} of {len(short)} sensors worse by more than 20 %"
    )


def _mean(values: Array) -> str:
    return f"{values.mean():.3f} ± {_stderr(values):.3f}"


def _stderr(values: Array) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.recommended_recipe", description=__doc__)
    parser.add_argument("--seeds", default="4001:4007", help="first and one after the last; two at least")
    pairs = []
    for seed in range(*map(int, parser.parse_args().seeds.split(":"))):
        pairs.append(both_ways(seed))
        shown = ("  ".join(f"{tried.errors[name]:.3f}" for name in FIGURES) for tried in pairs[-1])
        print(f"sensor {seed} [N], recommended and paper's: {'   '.join(shown)}", flush=True)
    for name, what in FIGURES.items():
        short, paper = (np.array([pair[way].errors[name] for pair in pairs]) for way in (0, 1))
        print("\n".join(summary(what, short, paper)))


if __name__ == "__main__":
    main()
