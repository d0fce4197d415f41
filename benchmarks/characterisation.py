"""How well a strip determines its material: the values in docs/explanation/characterisation.md.

``python -m benchmarks.characterisation`` characterises simulated strips in closed form, with the noise, relaxation
and residue of the shipped scene, over twelve seeds and both materials, and prints what came out, and how large
deviations are in stated errors, contacts apart; then the same of slopes from twelve cycles.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.strip.characterisation import characterise
from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.results.characterisation import Characterisation, FittedLine
from cbsr_qa.domain.sensor.sensor_type import Response

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from strip_samples import PAPER, Truth, readings, specimen

Array = NDArray[np.float64]

#: Material → noise of a reading.
MATERIALS = {"cbsr-8wt": 7.9e-4, "cbsr-9wt": 2.02e-4}
#: Share of a release that outlasts the relaxation in the shipped scene.
RESIDUE = 0.02


def strip(
    material: str, seed: int, strains: Sequence[float] = PAPER, cycles: int = 10, residue: float = RESIDUE
) -> Characterisation:
    truth = Truth(load_material(material).value, residue=residue)
    cycled = readings(truth, strains=strains, count=cycles, noise=MATERIALS[material], seed=seed)
    return characterise(cycled, specimen(Response.AUTO), CharacterisationSettings())


def slope(found: Characterisation) -> tuple[float, float]:
    """Local gauge factor and its standard error without what is assumed of the contacts."""
    line: FittedLine = found.local_against_strain
    assert line.line is not None
    parts = [error for part, error in line.parts if part != "contacts of the pins"]
    return line.line.slope.value, float(np.linalg.norm(parts))


def settling(found: Characterisation, loading: bool) -> tuple[float, float]:
    """Settling time of the conductance, of all strains together, with its standard error [s]."""
    (one,) = (o for o in found.settlings if (o.signal, o.loading, o.strain) == ("conductance", loading, None))
    assert one.settling.value_s is not None
    return one.settling.value_s, float(one.stderr_s or np.nan)


def modulus(found: Characterisation) -> tuple[float, float]:
    """Compressive modulus and its standard error [kPa]."""
    assert found.modulus_kPa is not None
    return found.modulus_kPa.value, float(found.modulus_kPa.stderr or np.nan)


#: Quantity → unit, digits that are printed, and value with stated error of one strip.
QUANTITIES: dict[str, tuple[str, int, Callable[[Characterisation], tuple[float, float]]]] = {
    "local gauge factor": ("", 4, slope),
    "modulus": (" kPa", 3, modulus),
    "settling after the press": (" s", 1, lambda found: settling(found, True)),
    "settling after the release": (" s", 1, lambda found: settling(found, False)),
}


def pairs(strips: Sequence[Characterisation], quantity: str) -> Array:
    """Values and stated errors of a quantity, (2, strips)."""
    return np.array([QUANTITIES[quantity][2](found) for found in strips]).T


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.characterisation", description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--short-seeds", type=int, default=40)
    chosen = parser.parse_args()
    for material in MATERIALS:
        strips = [strip(material, seed) for seed in range(chosen.seeds)]
        for quantity, (unit, digits, _) in QUANTITIES.items():
            values, errors = pairs(strips, quantity)
            deviation = values.std(ddof=1)
            print(
                f"{material}, 60 cycles, {quantity}: {values.mean():.{digits}f} ± {deviation:.{digits}f}{unit},"
                f" a deviation of {deviation / np.sqrt((errors**2).mean()):.2f} stated errors",
                flush=True,
            )
    for residue in (0.0, RESIDUE):
        strips = [strip("cbsr-8wt", seed, (0.1, 0.2, 0.3), 4, residue) for seed in range(chosen.short_seeds)]
        values, errors = pairs(strips, "local gauge factor")
        off = (values - 0.6) / errors
        print(f"cbsr-8wt, 12 cycles, residue {residue:g}: slopes off by {np.sqrt((off**2).mean()):.2f} stated errors")


if __name__ == "__main__":
    main()
