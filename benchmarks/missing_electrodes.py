"""How far a load's place is missed, and how often its region holds it, without some electrodes; prints a table.

    python -m benchmarks.missing_electrodes

Loads of 13 mm and contrast 0.5 within 35 mm of the centre of a 100 mm disc with 16 electrodes; noise of 1/5000 of the
largest reading. Of each number, electrodes are missing at random in four ways, 150 loads in all.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.eit.estimate.load_estimate import LoadEstimator
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads

_LOADS, _WAYS, _MOST = 150, 4, 8
_HEAD_RADIUS_MM, _CONTRAST, _FURTHEST_MM, _NOISE = 6.5, 0.5, 35.0, 2e-4
_LEVELS = (0.68, 0.95)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Located:
    """Errors of place [mm] of loads, and dᵀΣ⁻¹d of them, both (n,), from so many readings."""

    readings: int
    error_mm: Array
    square: Array


def main() -> None:
    """Print mean errors and coverage by the number of missing electrodes."""
    model = load_model(load_sensor_type("disc-100mm").value)
    random = np.random.default_rng([*b"missing"])
    angle, far = random.uniform(0, 2 * np.pi, _LOADS), _FURTHEST_MM * np.sqrt(random.uniform(size=_LOADS))
    place_mm = np.column_stack([far * np.cos(angle), far * np.sin(angle)])
    loads = RoundLoads.from_contrast(place_mm, np.full(_LOADS, _HEAD_RADIUS_MM), np.full(_LOADS, _CONTRAST))
    changes = model.readings(loads).change
    sigma = _NOISE * float(np.abs(model.solve_unloaded()[model.pattern.usable()]).max())
    changes = changes + sigma * random.normal(size=changes.shape)
    print("missing  readings     mean error [mm]   68 %   95 %   loads")
    for count in range(_MOST + 1):
        found = []
        for way in range(_WAYS):
            missing = np.random.default_rng([*b"missing", count, way]).choice(16, count, replace=False)
            some = np.arange(way, _LOADS, _WAYS)
            found.append(_located(model, missing.tolist(), changes[some], place_mm[some], sigma))
        print(f"{count:7d}  {_row([each for each in found if each is not None])}")


def _located(
    model: RoundLoadModel, missing: list[int], changes: Array, place_mm: Array, sigma: float
) -> Located | None:
    """Locate loads without some electrodes; None where too few readings are left."""
    pattern = model.pattern
    used = pattern.usable() & ~pattern.touching(missing)
    if pattern.too_few_readings(used) is not None:
        return None
    try:
        readings = merge_reciprocal(pattern, used, np.full(pattern.shape, sigma**2))
        estimate = LoadEstimator(model, readings, expected_radius_mm=_HEAD_RADIUS_MM, known=True)
    except NumericsError:
        return None
    error, square = [], []
    for true_mm, each in zip(place_mm, estimate.estimate(changes[:, used]), strict=True):
        if each.place_mm is not None and each.place_covariance_mm2 is not None:
            away = np.asarray(each.place_mm) - true_mm
            error.append(np.hypot(*away))
            square.append(away @ np.linalg.solve(each.place_covariance_mm2, away))
    return Located(int(used.sum()), np.array(error), np.array(square))


def _row(found: list[Located]) -> str:
    if not found:
        return "no estimate"
    readings = sorted({each.readings for each in found})
    error, square = (np.concatenate([getattr(each, name) for each in found]) for name in ("error_mm", "square"))
    shares = "   ".join(f"{np.mean(square <= chi2.ppf(level, 2)):4.0%}" for level in _LEVELS)
    return f"{readings[0]:3d} to {readings[-1]:3d}   {error.mean():15.2f}   {shares}   {len(error):5d}"


if __name__ == "__main__":
    main()
