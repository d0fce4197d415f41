"""Largest numbers of everything in a calibration, checked before any work that grows faster than the file."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from cbsr_qa.calibration.file.content import Entry
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.geometry.outlines import MOST_CORNERS
from cbsr_qa.domain.results.learned_place import MOST_PRESSES

#: Largest number of electrodes: what a sensor type may have.
_MOST_ELECTRODES: Final = 256
#: Largest number of pairs of each kind: 16 times as many as electrodes.
_MOST_PAIRS: Final = 4096
#: Largest number of readings: all drives with all measurements of 256 electrodes.
_MOST_READINGS: Final = 2**16
#: Largest number of places that a force model searches: 1 m by 1 m, by the millimetre.
_MOST_NODES: Final = 10**6
_MOST_LOADS: Final = 20_000
#: Largest number of kinds of relaxing signals; a run has two.
_MOST_SIGNALS: Final = 20

#: Largest whole number of an entry.
_LARGEST: Final = {
    "sensor_type/electrodes/count": _MOST_ELECTRODES,
    "sensor_type/pattern/electrode_count": _MOST_ELECTRODES,
    "identity/electrodes": _MOST_ELECTRODES,
}
#: Most rows of an entry.
_LONGEST: Final = {
    "sensor_type/electrodes/positions": _MOST_ELECTRODES,
    "sensor_type/pattern/drive": _MOST_PAIRS,
    "sensor_type/pattern/measure": _MOST_PAIRS,
    "sensor_type/outline/corners": MOST_CORNERS,
    "indenter/outline": MOST_CORNERS,
    "mesh/electrode_edge_counts": _MOST_ELECTRODES,
    "sensor_type/mesh/electrode_edge_counts": _MOST_ELECTRODES,
    "sensor_type/mesh/arc_edge_counts": _MOST_PAIRS,
    "readings/pairs": _MOST_READINGS,
    "readings/drive": _MOST_PAIRS,
    "readings/measure": _MOST_PAIRS,
    "place/process/features": MOST_PRESSES,
    "place/turns/permuted": 2 * _MOST_ELECTRODES,
    "force/values": MOST_PRESSES,
    "depth/values": MOST_PRESSES,
    "baseline_conductance/location": _MOST_LOADS,
    "presses/left_out/row": _MOST_LOADS,
}
#: Most values of an entry.
_LARGEST_TABLES: Final = {"force/node": _MOST_NODES, "reference/voltages": 4 * _MOST_READINGS}
_RELAXATION: Final = "relaxation/"


def check_counts(entries: Mapping[str, Entry]) -> None:
    """Raise CalibrationError, naming the entry, if a calibration holds more of something than any sensor has."""
    for path, number, allowed in _list_counts(entries):
        if number > allowed:
            raise CalibrationError(f"{path}: {number} is too many; a calibration has at most {allowed}")


def _list_counts(entries: Mapping[str, Entry]) -> Iterator[tuple[str, int, int]]:
    """Yield what is counted: its path, its number, and how many are allowed."""
    for path, allowed in _LARGEST.items():
        value = entries[path].value if path in entries else None
        if isinstance(value, np.ndarray) and value.shape == () and value.dtype == np.int64:
            yield path, int(value), allowed
    for path, allowed in _LONGEST.items():
        yield path, _length(entries, path), allowed
    pairs = entries["readings/pairs"].value if "readings/pairs" in entries else None
    if isinstance(pairs, np.ndarray) and pairs.ndim == 2 and pairs.shape[1] == 4:
        for columns in (pairs[:, :2], pairs[:, 2:]):
            yield "readings/pairs, of different electrodes", len(np.unique(columns, axis=0)), _MOST_PAIRS
    used_mask = entries["reconstruction/used"].value if "reconstruction/used" in entries else None
    if isinstance(used_mask, np.ndarray) and used_mask.dtype == np.bool_:
        yield "reconstruction/used, readings", int(used_mask.sum()), _MOST_READINGS
    for path, allowed in _LARGEST_TABLES.items():
        table = entries[path].value if path in entries else None
        if isinstance(table, np.ndarray):
            yield path, table.size, allowed
    signals = {path.split("/")[1] for path in entries if path.startswith(_RELAXATION)}
    yield "relaxation, signals", len(signals), _MOST_SIGNALS
    for signal in sorted(signals):
        path = f"{_RELAXATION}{signal}/number"
        yield path, _length(entries, path), _MOST_LOADS


def _length(entries: Mapping[str, Entry], path: str) -> int:
    value = entries[path].value if path in entries else ()
    return len(value) if isinstance(value, tuple) or (isinstance(value, np.ndarray) and value.ndim) else 0
