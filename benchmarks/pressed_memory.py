"""Memory and time that learning from presses of a simulated sheet takes.

``python -m benchmarks.pressed_memory 1600 16`` learns from 1600 presses of a sheet with 16 electrodes, all driven and
measured by neighbours (208 readings; 928 with 32 electrodes), as ``cbsr-qa calibrate`` does. It prints every stage as
it begins, and at the end peak memory and processor time.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import resource
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

from cbsr_qa.calibration.presses.learning import learn_presses

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "samples"))

from pressed_sheets import adjacent_pairs, pressed_sheet


def main() -> None:
    """Learn from as many presses as asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presses", type=int)
    parser.add_argument("electrodes", type=int)
    asked = parser.parse_args()
    pairs = adjacent_pairs(asked.electrodes)
    sheet = pressed_sheet(asked.presses, seed=5, pairs=pairs, electrodes=asked.electrodes, noise=0.05)
    labelled = sheet.labelled()
    labelled = replace(labelled, presses=replace(labelled.presses, force_N=sheet.force_N))
    begin, processor_begin = perf_counter(), process_time()

    def tell(stage: str) -> None:
        print(
            f"{perf_counter() - begin:6.0f} s, {process_time() - processor_begin:6.0f} s of a processor: {stage}",
            flush=True,
        )

    learned = learn_presses(labelled, tell=tell)
    held = learned.place.held_out
    tell(f"{held.mean_mm:.3f} ± {held.stderr_mm:.3f} mm, {len(pairs)} readings of {asked.presses} presses")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2:.2f} GB")


if __name__ == "__main__":
    main()
