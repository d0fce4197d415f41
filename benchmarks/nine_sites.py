"""Nine loads simulated on a mesh of their own, and what an image makes of them: shared by all parts that localise."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Image, ImagingProblem
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.imaging.blobs import nearest_blob
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.imaging.shape import spatial_figures
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.mesh.sheet import sheet_mesh

Array = NDArray[np.float64]

RADIUS_MM = 6.5
SIZE_MM = 2.3  # of the true sheet's mesh, of the second order; images are made with a coarser one
CONTACT_MM = 0.3  # and its contacts are not the nominal ones
MASK = 0.85


@dataclass(frozen=True)
class Loads:
    """Readings of an unloaded sheet, and their changes under each load.

    Parameters
    ----------
    reference : (drives, measures).
    changes : (sites, drives, measures), without noise.
    places : (sites, 2) [mm].
    """

    reference: Array
    changes: Array
    places: Array

    def noisy(self, problem: ImagingProblem, decibels: float, frames: int, seed: int = 1) -> Array:
        """Changes of a problem's readings with noise so far below each reading: (sites, frames, m)."""
        clean = self.changes[:, problem.used][:, None]
        size = 10 ** (-decibels / 20) * np.abs(self.reference[problem.used])
        drawn = np.random.default_rng(seed).standard_normal((len(clean), frames, clean.shape[2]))
        return clean + size * drawn


@dataclass(frozen=True)
class Score:
    """Figures over all sites and frames; the worst site is that of the largest mean error."""

    error_mm: float
    worst_mm: float
    overlap_percent: float
    deviation_mm2: float
    stderr_mm: float | None = None

    def words(self) -> str:
        sure = "" if self.stderr_mm is None else f" ± {self.stderr_mm:.2f}"
        return (
            f"E_CoM {self.error_mm:.2f}{sure} mm (worst site {self.worst_mm:.2f}), A_OL {self.overlap_percent:.1f} %,"
            f" SD {self.deviation_mm2:.2f} mm²"
        )


def mean_score(scores: Sequence[Score]) -> Score:
    """Mean of the scores of several seeds, with the standard error of the error."""
    values = np.array([[one.error_mm, one.worst_mm, one.overlap_percent, one.deviation_mm2] for one in scores])
    stderr = float(values[:, 0].std(ddof=1) / np.sqrt(len(scores)))
    error, worst, overlap, deviation = values.mean(axis=0).tolist()
    return Score(error, worst, overlap, deviation, stderr)


@lru_cache(maxsize=1)
def loads() -> Loads:
    """Simulate loads of +50 % at the nine sites of the 100 mm disc, one at a time."""
    return _loads_at(np.array(NINE_LOCATIONS_MM, dtype=np.float64))


def elsewhere(count: int = 20) -> Loads:
    """The same at other places, up to 32 mm out and none within 4 mm of the nine; seeded."""
    random, places = np.random.default_rng(31), []
    while len(places) < count:
        away, turn = 32 * np.sqrt(random.uniform()), random.uniform(0, 2 * np.pi)
        place = away * np.array([np.cos(turn), np.sin(turn)])
        if np.hypot(*(np.array(NINE_LOCATIONS_MM) - place).T).min() > 4:
            places.append(place)
    return _loads_at(np.array(places))


def _loads_at(places: Array, contrast: float = 0.5, radius_mm: float = RADIUS_MM) -> Loads:
    sensor = disc()
    local = _sheet()
    reference, changes = local.model.voltages(), []
    for x, y in places:
        covered = cover(local.model.elements, RoundFootprint(float(x), float(y), radius_mm))
        pressed = local.voltages(covered.elements, covered.change(local.model.conductance, contrast))
        changes.append(pressed - reference)
    assert reference.shape == sensor.pattern.shape
    return Loads(reference, np.array(changes), places)


@lru_cache(maxsize=1)
def disc() -> SensorType:
    return load_sensor_type("disc-100mm").value


@lru_cache(maxsize=1)
def _sheet() -> LocalUpdate:
    mesh = sheet_mesh(disc(), size_mm=SIZE_MM, order=2)
    contacts = np.full(disc().electrodes.count, CONTACT_MM)
    return LocalUpdate(ForwardModel(mesh, disc().pattern, np.ones(len(mesh.elements)), contacts, order=2))


def score(images: ArrayLike, mesh: Mesh, places: Array, radius_mm: float = RADIUS_MM) -> Score:
    """Figures of images (sites, frames, e) at the 85 % mask, the region bounded by a contour."""
    figures = np.array(
        [
            [_figures(image, mesh, RoundFootprint(float(x), float(y), radius_mm)) for image in frames]
            for frames, (x, y) in zip(np.asarray(images), places, strict=True)
        ]
    )
    error, overlap, deviation = figures.mean(axis=(0, 1))
    return Score(float(error), float(figures[..., 0].mean(axis=1).max()), float(overlap), float(deviation))


def _figures(values: Array, mesh: Mesh, head: RoundFootprint) -> tuple[float, float, float]:
    region = nearest_blob(contour_regions(Image(mesh, values), MASK), *head.centre_mm)
    (found,) = spatial_figures([region], head)
    assert found is not None
    return found.error_mm, found.overlap_percent, found.deviation_mm2
