"""Two heads in one frame: what ``force`` and ``forces`` of a calibration make of them.

``python -m benchmarks.several_heads`` prints the table of docs/explanation/force.md, of two sheets with an uneven
response and forty pairs a distance, and what single loads are taken for. Sheets learn from exact readings with
noise; the pairs press on finite elements.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.simulate.sheet import SimulatedSheet

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from force_samples import HEAD, NOISE, in_use, learned, line, pressed, setting, smooth_response, somewhere

Array = NDArray[np.float64]

DISTANCES_MM = (15.0, 20.0, 25.0, 30.0, 40.0, 60.0)
_SHEETS = (5, 6)
_CALIBRATED, _RADIUS_MM, _FORCES_N = 40, 40.0, (1.0, 5.0)
_COLUMNS = (
    "apart",
    "flagged by `force`",
    "one head reads, of the sum",
    "found by `forces`",
    "told apart",
    "σ of each force",
    "its 68 and 95 % intervals hold",
    "place, rms",
    "sum: bias, σ",
)


class Sheet:
    """A sheet whose response varies by 20 %, its calibration, and the finite elements that are pressed.

    Parameters
    ----------
    seed : of the response, of the loads it is learned from and of those that are pressed.
    """

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        response: Callable[[Array], Array] = smooth_response(seed, 0.2)
        places = somewhere(self.random, _CALIBRATED)
        found = learned(pressed(self.random, response, places, self.random.uniform(*_FORCES_N, _CALIBRATED)))
        self.calibration: Calibration = in_use(found.model, found.line)
        design = SheetDesign.make_uniform(load_sensor_type("disc-100mm").value, HEAD)
        design.response.append(response)
        ohm = load_material("cbsr-8wt").value.interelectrode_resistance_ohm.value
        self._elements = SimulatedSheet(design, size_mm=5.0, interelectrode_resistance_ohm=ohm)

    def frame(self, places_mm: Array, force_N: Array) -> Array:
        """One frame of heads that press together, with noise."""
        contrast = line().slope.value * force_N / HEAD.area_mm2 * 1e3 + line().intercept.value
        changes = {(float(x), float(y)): float(value) for (x, y), value in zip(places_mm, contrast, strict=True)}
        elements = self._elements
        # The change alone: mesh and expansion do not share their unloaded readings to the last digits of a change.
        change = (elements.voltages(changes) - elements.unloaded) * elements.conductance_S
        noisy: Array = setting().model.solve_unloaded() + change + NOISE * self.random.standard_normal(change.shape)
        return noisy

    def loads(self, distance_mm: float, count: int) -> Iterator[tuple[Array, Array]]:
        """Places (2, 2) and forces (2,) of pairs this far apart, anywhere within 40 mm."""
        while count:
            middle, angle = somewhere(self.random, 1, _RADIUS_MM)[0], self.random.uniform(0, np.pi)
            way = distance_mm / 2 * np.array([np.cos(angle), np.sin(angle)])
            places = np.array([middle + way, middle - way])
            if np.hypot(*places.T).max() < _RADIUS_MM:
                count -= 1
                yield places, self.random.uniform(*_FORCES_N, 2)


@dataclass(frozen=True)
class Pair:
    """What was made of one pair.

    Parameters
    ----------
    flagged : whether ``force`` says that there is more than one.
    one_of_sum : estimated single force over the sum of both.
    found : whether ``forces`` reports two, or flags them.
    error_N, stderr_N, place_mm : errors of each head's force and place; empty for one head.
    sum_error : of both together, relative.
    """

    flagged: bool
    one_of_sum: float
    found: bool
    error_N: Array
    stderr_N: Array
    place_mm: Array
    sum_error: float


def pair(sheet: Sheet, places_mm: Array, force_N: Array) -> Pair:
    frame, nothing = sheet.frame(places_mm, force_N), np.empty(0)
    one = sheet.calibration.force(frame)
    (both,) = sheet.calibration.forces(frame)
    off = np.hypot(*(both.loads.place_mm[:, None] - places_mm).transpose(2, 0, 1))
    near = off.argmin(axis=1)
    apart = sorted(near) == [0, 1]
    return Pair(
        flagged=bool(one.flags[0] & Flag.MORE_THAN_ONE),
        one_of_sum=float(one.force_N[0] / force_N.sum()),
        found=apart or bool(both.flags & Flag.MORE_THAN_ONE),
        error_N=both.loads.force_N - force_N[near] if apart else nothing,
        stderr_N=both.loads.stderr_N if apart else nothing,
        place_mm=off.min(axis=1) if apart else nothing,
        sum_error=float(both.total_N / force_N.sum() - 1),
    )


def row(distance_mm: float, pairs: Sequence[Pair]) -> str:
    names = ("error_N", "stderr_N", "place_mm")
    error, stderr, place = (np.concatenate([getattr(one, name) for one in pairs]) for name in names)
    within = [100 * np.mean(np.abs(error) <= reach * stderr) for reach in (1.0, 1.96)]
    sums = 100 * np.array([p.sum_error for p in pairs])
    cells = (
        f"{distance_mm:.0f} mm",
        f"{100 * np.mean([p.flagged for p in pairs]):.0f} %",
        f"{np.mean([p.one_of_sum for p in pairs]):.2f}",
        f"{100 * np.mean([p.found for p in pairs]):.0f} %",
        f"{100 * np.mean([len(p.error_N) > 0 for p in pairs]):.0f} %",
        f"{error.std(ddof=1):.2f} N",
        f"{within[0]:.0f}, {within[1]:.0f} %",
        f"{np.sqrt(np.mean(place**2)):.1f} mm",
        f"{sums.mean():.1f}, {sums.std(ddof=1):.1f} %".replace("-", "−"),
    )
    return f"| {' | '.join(cells)} |"


def taken_for_two(sheet: Sheet, count: int) -> int:
    """How many of so many single loads are flagged, or not reported as one."""
    wrong = 0
    for place in somewhere(sheet.random, count, _RADIUS_MM):
        frame = sheet.frame(place[None], sheet.random.uniform(*_FORCES_N, 1))
        (told,) = sheet.calibration.forces(frame)
        flagged = bool((sheet.calibration.force(frame).flags[0] | told.flags) & Flag.MORE_THAN_ONE)
        wrong += flagged or len(told.loads.force_N) != 1
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.several_heads", description=__doc__)
    parser.add_argument("--pairs", type=int, default=20, help="a sheet and distance")
    count = parser.parse_args().pairs
    sheets = [Sheet(seed) for seed in _SHEETS]
    print(f"| {' | '.join(_COLUMNS)} |\n|{' --- |' * len(_COLUMNS)}")
    for distance_mm in DISTANCES_MM:
        pairs = [pair(sheet, *load) for sheet in sheets for load in sheet.loads(distance_mm, count)]
        print(row(distance_mm, pairs), flush=True)
    wrong = sum(taken_for_two(sheet, 2 * count) for sheet in sheets)
    print(f"of {2 * count * len(sheets)} single loads {wrong} flagged or taken for two")


if __name__ == "__main__":
    main()
