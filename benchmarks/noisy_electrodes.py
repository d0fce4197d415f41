"""How often readings of an electrode are taken for noise, on sheets pressed up to their electrodes.

``python -m benchmarks.noisy_electrodes 6`` learns from 100 presses of each of six simulated sheets, sound and with
noise of 20 median changes at one electrode in five presses (4 s each): the numbers of docs/explanation/place.md.
Presses lie within 62 mm of the centre of a sheet of 73 mm; pairs are adjacent or opposite, in turn.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from cbsr_qa.calibration.presses.learning import learn_presses

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import Pressed, adjacent_pairs, opposite_pairs, pressed_sheet

_PRESSES, _SPOILED, _NOISE = 100, 5, 20.0


def main() -> None:
    """Print how many presses were accused on sound sheets, and on sheets with so many spoiled ones."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    for seed in range(100, 100 + count):
        pairs = (adjacent_pairs(), opposite_pairs())[seed % 2]
        sheet = pressed_sheet(_PRESSES, seed=seed, pairs=pairs, reach=62 / 73, noise=0.05)
        for name, pressed in (("sound", sheet), (f"{_SPOILED} spoiled", spoil(sheet, seed))):
            place = learn_presses(pressed.labelled()).place
            accused = re.search(r"noise, and are left out: (\d+)", "\n".join(place.warnings))
            error = f"{place.held_out.mean_mm:.3f} ± {place.held_out.stderr_mm:.3f} mm"
            print(
                f"sheet {seed}, {len(pairs)} readings, {name}: {accused[1] if accused else 0} accused, {error}",
                flush=True,
            )


def spoil(sheet: Pressed, seed: int) -> Pressed:
    """Replace the readings of one electrode in some presses by noise."""
    random, changes = np.random.default_rng([seed, 1]), sheet.changes.copy()
    for press in random.choice(len(changes), _SPOILED, replace=False):
        group = (sheet.pairs == random.integers(16)).any(axis=1)
        changes[press, group] = _NOISE * np.median(np.abs(sheet.changes)) * random.standard_normal(group.sum())
    return replace(sheet, changes=changes)


if __name__ == "__main__":
    main()
