"""Simulated sheets pressed at known places, as tables: any pairs in any order, labels in a frame of their own."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from made_once import value_made_once
from scipy.io import loadmat

from cbsr_qa.calibration.place.pairs import DistinctPairs
from cbsr_qa.calibration.presses.inputs import LabelledPresses, PressReadings
from cbsr_qa.calibration.presses.issue import Identity, issue_from_presses
from cbsr_qa.calibration.presses.learning import learn_presses
from cbsr_qa.calibration.presses.number_tables import NumberTable
from cbsr_qa.calibration.presses.tables import PressTable
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads

RADIUS_MM = 73.0
#: The sensor type of :func:`round_sensor` as a file.
SKIN_TOML = """
[sensor_type]
name = "skin"
radius_mm = 73
thickness_mm = 3
[electrodes]
kind = "pin"
count = 16
ring_radius_mm = 70.08
diameter_mm = 2.19
"""


def round_sensor(radius_mm=RADIUS_MM, count=16):
    layout = ElectrodeLayout(count, ElectrodeKind.PIN, 0.96 * radius_mm, 0.03 * radius_mm, 0.0, True)
    return SensorType("skin", radius_mm, 3.0, layout, adjacent_pattern(count), Response.AUTO)


def opposite_pairs(count=16):
    """Opposite drive in both polarities, adjacent measure, none at a driven electrode: 192 of 16 electrodes."""
    return np.array(
        [
            (source, (source + count // 2) % count, (k + 1) % count, k)
            for source in range(count)
            for k in range(count)
            if not {source, (source + count // 2) % count} & {k, (k + 1) % count}
        ]
    )


def adjacent_pairs(count=16):
    return np.array(
        [
            (d, (d + 1) % count, m, (m + 1) % count)
            for d in range(count)
            for m in range(count)
            if not {d, (d + 1) % count} & {m, (m + 1) % count}
        ]
    )


def readings(sensor, pairs, places_mm, *, contrast, radius_mm=6.0):
    """Readings (n, m) of a sheet with a load each at places (n, 2), and without (m,)."""
    drive = tuple(dict.fromkeys((s, t) for s, t, _, _ in pairs.tolist()))
    measure = tuple(dict.fromkeys((p, q) for _, _, p, q in pairs.tolist()))
    pattern = DrivePattern(sensor.electrodes.count, drive, measure)
    model = RoundLoadModel(load_model(sensor).surroundings, pattern)
    row = [drive.index((s, t)) for s, t, _, _ in pairs.tolist()]
    column = [measure.index((p, q)) for _, _, p, q in pairs.tolist()]
    count = len(places_mm)
    loads = RoundLoads.from_contrast(places_mm, np.full(count, radius_mm), np.broadcast_to(contrast, count))
    unloaded = model.solve_unloaded()
    return (unloaded + model.readings(loads).change)[:, row, column], unloaded[row, column]


@dataclass(frozen=True)
class Pressed:
    """A pressed sheet: ``labels_mm`` = shift + scale · R(rotation) · mirror · ``places_mm``."""

    sensor: SensorType
    pairs: np.ndarray
    places_mm: np.ndarray
    labels_mm: np.ndarray
    changes: np.ndarray
    unloaded: np.ndarray
    force_N: np.ndarray

    def labelled(self):
        """What ``calibrate`` reads from these tables."""
        table = NumberTable(Path("presses.csv"), (), np.zeros((0, 0)))
        distinct = DistinctPairs.from_pairs(self.pairs)
        readings = PressReadings(Path("readings.csv"), distinct, self.changes @ distinct.merging)
        return LabelledPresses(self.sensor, True, readings, PressTable(table, self.labels_mm, None, None, None))

    def write(self, folder: Path, *, labels=None):
        """READINGS, PRESSES and PAIRS as CSV files; returns their paths."""
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / name for name in ("readings.csv", "presses.csv", "pairs.csv")]
        table(paths[0], [f"r{k}" for k in range(len(self.pairs))], self.changes)
        columns = {"x_mm": self.labels_mm[:, 0], "y_mm": self.labels_mm[:, 1]} | (labels or {})
        table(paths[1], columns, np.column_stack(list(columns.values())))
        table(paths[2], ["source", "sink", "plus", "minus"], self.pairs)
        return paths


def table(path, columns, rows):
    lines = [",".join(columns), *(",".join(repr(float(x)).removesuffix(".0") for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def pressed_sheet(
    count=100,
    *,
    seed=1,
    pairs=None,
    radius_mm=RADIUS_MM,
    reach=0.62,
    rotation_deg=25.0,
    mirrored=False,
    scale=1.0,
    shift_mm=(46.0, -408.0),
    noise=0.02,
    uneven=0.0,
    rectified=False,
    wired=None,
    electrodes=16,
):
    """Press a simulated sheet.

    ``noise``: of a reading over the median change; ``uneven``: standard deviation of the logarithm of what places
    answer per force, over some 20 mm; ``wired``: electrode that each number of the pattern is wired to.
    """
    random = np.random.default_rng(seed)
    sensor = round_sensor(radius_mm, electrodes)
    pairs = opposite_pairs(electrodes) if pairs is None else pairs
    angle, far = random.uniform(0, 2 * np.pi, count), reach * radius_mm * np.sqrt(random.uniform(0, 1, count))
    places = np.column_stack([far * np.cos(angle), far * np.sin(angle)])
    force = random.uniform(1.0, 5.0, count)
    true_pairs = pairs if wired is None else np.asarray(wired)[pairs]
    loaded, unloaded = readings(
        sensor, true_pairs, places, contrast=0.1 * force * np.exp(uneven * _relief(places, seed))
    )
    if rectified:
        loaded, unloaded = np.maximum(loaded, 0), np.maximum(unloaded, 0)
    changes = loaded - unloaded
    changes = changes + noise * np.median(np.abs(changes)) * random.standard_normal(changes.shape)
    z = places @ np.array([1, -1j if mirrored else 1j])
    z = scale * np.exp(1j * np.radians(rotation_deg)) * z
    labels = np.column_stack([z.real, z.imag]) + shift_mm
    return Pressed(sensor, pairs, places, labels, 1e3 * changes, 1e3 * unloaded, force)


def _relief(places, seed):
    """A random function of places (n, 2), normal with a deviation of one and a length of 20 mm."""
    random = np.random.default_rng([seed, 20])
    waves, phases = random.standard_normal((80, 2)) / 20, random.uniform(0, 2 * np.pi, 80)
    return np.cos(places @ waves.T + phases).sum(axis=1) / 40**0.5


def issued_from_presses():
    """A calibration of place and force from twelve presses, made once: that takes seconds."""

    def issue():
        sheet = pressed_sheet(12, noise=0.05)
        labelled = sheet.labelled()
        labelled = replace(labelled, presses=replace(labelled.presses, force_N=sheet.force_N))
        return issue_from_presses(Identity("id", "now", ()), labelled, learn_presses(labelled))

    return value_made_once("issued from presses", issue)


def skin(folder, name):
    """A real skin (``shared/data/skins``): of its presses the labels and the changes are known."""
    changes, presses = (
        np.loadtxt(folder / name / f"{each}.csv", delimiter=",", encoding="utf-8-sig")
        for each in ("readings", "presses")
    )
    pairs = loadmat(folder / "lookup192.mat")["lookup"].astype(np.int64) // 2
    unknown = np.full(len(presses), np.nan)
    labels_mm = 1e3 * presses[:, :2]
    return Pressed(round_sensor(), pairs, np.full_like(labels_mm, np.nan), labels_mm, changes, unknown, unknown)


def some(pressed, rows):
    """The same with some of its presses."""
    return replace(
        pressed,
        places_mm=pressed.places_mm[rows],
        labels_mm=pressed.labels_mm[rows],
        changes=pressed.changes[rows],
        force_N=pressed.force_N[rows],
    )
