"""How often faults put into recordings are named, with their readings or times and nothing else; prints a table.

    python -m benchmarks.faulty_readings [RECORDINGS]

Recordings of a 100 mm disc in counts: 160 frames, one press, noise of 0.8 % of the largest reading that is imaged.
"""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.spikes import remove_spikes
from cbsr_qa.analysis.recording.imaging import nominal_disc
from cbsr_qa.analysis.recording.ready import ReadyReadings, make_ready
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, ScanKind, VoltageUnit
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.inverse.problem import nominal_model
from cbsr_qa.eit.loads.local import LocalUpdate

_FRAMES, _PRESSED, _RATE_HZ = 160, slice(50, 100), 4.0
_LARGEST, _NOISE, _OFFSET = 2500.0, 20.0, 11000.0  # counts
_SENSOR = nominal_disc(None, 16)
_USED = _SENSOR.pattern.usable()

Array = NDArray[np.float64]


def main() -> None:
    """Print how many faults of each kind were named exactly."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    still, named = _noiseless(), Counter[str]()
    for seed in range(count):
        random = np.random.default_rng([*b"faults", seed])
        named += _named(np.round(still + random.normal(0.0, _NOISE, still.shape)), random)
    for what in ("clean, nothing named", "three offsets", "dead drive", "four open electrodes", "stuck reading"):
        print(f"{what:24s} {named[what]} of {count}")
    print(f"{'spikes':24s} {named['spikes found']} of {named['spikes']}, and {named['no spikes']} others")


def _noiseless() -> Array:
    """Counts (frames, drives, measures) of one press."""
    sheet = LocalUpdate(nominal_model(_SENSOR))
    empty = sheet.model.voltages()
    elements, share = disc_coverage(sheet.model.mesh, 15.0, 20.0, 7.5)
    scale = _LARGEST / np.abs(empty[_USED]).max()
    frames = np.tile(empty, (_FRAMES, 1, 1))
    frames[_PRESSED] = sheet.voltages(elements, -0.3 * share)
    return np.where(_USED, scale * frames, np.clip(scale * frames, -30000.0, 30000.0)) + _OFFSET


def _named(clean: Array, random: np.random.Generator) -> Counter[str]:
    """Put each fault into a recording, and count what is named exactly."""
    named = Counter({"clean, nothing named": int(not _ready(clean).remarks())})

    at = np.sort(random.choice(np.arange(5, _FRAMES - 5), 3, replace=False))
    steps = random.choice([-1, 1], 3) * _NOISE * random.uniform(2, 20, 3)
    offsets = clean + ((np.arange(_FRAMES)[:, None] >= at) @ steps)[:, None, None]
    named["three offsets"] += [frame for frame, _ in _ready(offsets).offsets] == at.tolist()

    faulty, drive = clean.copy(), int(random.integers(len(_USED)))
    faulty[:, drive] = np.round(_OFFSET + random.uniform(0.05, 0.3) * (clean[:, drive] - _OFFSET))
    named["dead drive"] += [each.drive for each in _ready(faulty).dead_drives] == [drive]

    faulty, opened = clean.copy(), set(random.choice(16, 4, replace=False).tolist())
    silent = _SENSOR.pattern.touching(sorted(opened))
    faulty[:, silent] = np.round(random.normal(_OFFSET, _NOISE, faulty[:, silent].shape))
    # An electrode between two of them carries nothing either, and is named with them.
    named["four open electrodes"] += opened <= set(_ready(faulty).open_electrodes)

    faulty, (drive, measure) = clean.copy(), np.argwhere(_USED)[random.integers(_USED.sum())].tolist()
    faulty[:, drive, measure] = clean[0, drive, measure] + random.integers(0, 2, _FRAMES)
    named["stuck reading"] += np.argwhere(_ready(faulty).faults.stuck).tolist() == [[drive, measure]]

    hit = (random.random(clean.shape) < 1e-3) & _USED
    jumps = random.choice([-1, 1], clean.shape) * _NOISE * random.uniform(10, 100, clean.shape)
    _, found = remove_spikes(clean + hit * jumps, _USED, counts=True)
    spikes = {"spikes": hit, "spikes found": hit & found, "no spikes": found & ~hit}
    return named + Counter({what: int(each.sum()) for what, each in spikes.items()})


def _ready(counts: Array) -> ReadyReadings:
    flags = np.zeros(counts.shape, np.uint8)
    block = FrameBlock(np.arange(len(counts)) / _RATE_HZ, counts, flags, VoltageUnit.COUNT, None)
    made = Path("made.csv")
    return make_ready(
        Recording(made, "made", "", ScanKind.FULL, block, None, still=False, magnitudes_only=False, clock="board"),
        None,
    )


if __name__ == "__main__":
    main()
