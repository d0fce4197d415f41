"""Trials of the load estimate against the Cramér–Rao bound, over contrasts, noise, places and sizes.

Truth comes from another model than the estimator's: finite elements of second order on meshes that follow the load's
outline, where the estimator sums multipoles. Noise is Gaussian and independent, of every reading its own 10^(−dB/20):
that reading of "dB per channel" gives the bounds that are known from elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.load_bound import LoadBound, load_bound
from benchmarks.reference_solutions import fitted_mesh
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.estimate.load_estimate import LoadEstimator, LoadFits, contrast_of, radius_of
from cbsr_qa.eit.estimate.readings import MergedReadings, load_model, merge_reciprocal
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.problem import NOMINAL_CONTACT_MM
from cbsr_qa.eit.mesh.sheet import sheet_mesh

Array = NDArray[np.float64]
Place = tuple[float, float]  # distance from the centre [mm], direction [°]

CONTRASTS = (0.03, 0.10, 0.18, 0.50)
DECIBELS = (40, 50, 60, 70, 80)
#: Pins lie at multiples of 22.5°: at 40 mm once towards one and once between two.
PLACES: tuple[Place, ...] = ((0, 0), (21, 45), (21, 100), (30, 0), (30, 191.25), (40, 90), (40, 281.25))
#: A head of 20 mm at 40 mm would touch the edge and cover a pin.
LARGE_PLACES: tuple[Place, ...] = (*PLACES[:5], (36, 90), (36, 281.25))

_ASKED_D, _ASKED_SHARE = 10.0, 1 / 3
_SPREAD, _BIAS, _COVER = 1.2, 0.3, (0.64, 0.72)
BORDER_D, BORDER_SHARE = 6.0, 1.4
TRIALS, AGAIN, REFUSALS = 500, 2000, 100
_MESH_MM = 2.0


@dataclass(frozen=True)
class Cell:
    diameter_mm: float
    known: bool
    contrast: float
    decibels: int
    place: Place

    @property
    def radius_mm(self) -> float:
        return self.diameter_mm / 2

    @property
    def centre_mm(self) -> tuple[float, float]:
        away, direction = self.place[0], np.deg2rad(self.place[1])
        return float(away * np.cos(direction)), float(away * np.sin(direction))


@dataclass(frozen=True)
class Score:
    """Of one quantity in one cell: spread and bias over the bound, and share of 68 % regions that hold the truth."""

    spread: float
    bias: float
    cover: float

    @property
    def met(self) -> bool:
        return self.spread <= _SPREAD and self.bias <= _BIAS and _COVER[0] <= self.cover <= _COVER[1]


@dataclass(frozen=True)
class Judged:
    """A cell's answers. ``scores``: ``place`` and ``amplitude``, and ``diameter`` if requested."""

    cell: Cell
    bound: LoadBound
    asked: bool
    answered: float
    with_radius: float
    scores: dict[str, Score]
    again: bool

    @property
    def border(self) -> bool:
        """Not expected, but within the scatter of d′ and standard errors from frame to frame."""
        beyond = self.bound.place_mm / (_ASKED_SHARE * self.cell.radius_mm)
        return not self.asked and self.bound.detectability >= BORDER_D and beyond <= BORDER_SHARE


def judge(cell: Cell) -> Judged:
    """Run the trials of a cell.

    Where coverage fell outside, or anything was answered that should not be, once more with 2000 fresh ones, which
    alone count. Of 500 trials 64 to 72 % is two standard deviations of the binomial about 68 %: five cells of a
    hundred would fail by chance.
    """
    estimator, readings = estimator_of(cell.diameter_mm, cell.known, cell.decibels)
    x_mm, y_mm = cell.centre_mm
    bound = load_bound(
        estimator.model, readings, x_mm=x_mm, y_mm=y_mm, radius_mm=cell.radius_mm, contrast=cell.contrast,
        known=cell.known,
    )  # fmt: skip
    asked = bound.detectability >= _ASKED_D and bound.place_mm <= _ASKED_SHARE * cell.radius_mm
    found = _trials(cell, estimator, TRIALS if asked else REFUSALS, 0)
    judged = _judged(cell, bound, asked, found, again=False)
    if not asked and not judged.border and judged.answered > 0:
        return _judged(cell, bound, asked, _trials(cell, estimator, AGAIN, 1), again=True)
    if asked and any(not _COVER[0] <= score.cover <= _COVER[1] for score in judged.scores.values()):
        judged = _judged(cell, bound, asked, _trials(cell, estimator, AGAIN, 1), again=True)
    return judged


def _trials(cell: Cell, estimator: LoadEstimator, count: int, stream: int) -> LoadFits:
    used = estimator.readings.used
    signal = truth(cell.diameter_mm, cell.place)[cell.contrast][used]
    key = (round(10 * cell.diameter_mm), cell.known, round(1000 * cell.contrast), cell.decibels)
    seed = np.random.SeedSequence([*map(int, key), int(cell.place[0]), int(100 * cell.place[1]), stream])
    noise = np.random.default_rng(seed).standard_normal((count, int(used.sum())))
    return estimator.fit(signal + noise * deviation(cell.decibels)[used])


def _judged(cell: Cell, bound: LoadBound, asked: bool, found: LoadFits, *, again: bool) -> Judged:
    located = found.finding == 0
    scores = {}
    if asked and located.sum() > 1:
        fits, covariance = found.fits.parameters[located], found.fits.covariance[located]
        scores["place"] = _place_score(cell, bound, fits[:, :2], covariance[:, :2, :2])
        scores["amplitude"] = _amplitude_score(cell, bound, fits, covariance)
        if not cell.known and bound.radius_stderr_mm <= _ASKED_SHARE * cell.radius_mm and found.has_radius.sum() > 1:
            scores["diameter"] = _radius_score(cell, bound, found)
    return Judged(cell, bound, asked, float(located.mean()), float(found.has_radius.mean()), scores, again)


def _place_score(cell: Cell, bound: LoadBound, places: Array, covariance: Array) -> Score:
    """Along the worse of the bound's principal axes."""
    error = places - np.array(cell.centre_mm)
    size, axes = np.linalg.eigh(bound.covariance[:2, :2])
    along = error @ axes / np.sqrt(size)
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    inside = distance <= -2 * np.log(1 - 0.6827)
    return Score(float(along.std(axis=0).max()), float(np.abs(along.mean(axis=0)).max()), float(inside.mean()))


def _amplitude_score(cell: Cell, bound: LoadBound, fits: Array, covariance: Array) -> Score:
    """Contrast where the indenter is known, else area × contrast."""
    error = np.sqrt(covariance[:, 2, 2])
    strength = cell.radius_mm**2 * cell.contrast / (2 + cell.contrast)
    if not cell.known:
        return _score(fits[:, 2], strength, bound.strength * strength, fits[:, 2] - error, fits[:, 2] + error)
    found = [contrast_of(m, e) for m, e in zip(fits[:, 2] / fits[:, 3], error / fits[:, 3], strict=True)]
    value, low, high = np.array([(f.value, f.low, f.high) for f in found]).T
    return _score(value, cell.contrast, bound.contrast_stderr, low, high)


def _radius_score(cell: Cell, bound: LoadBound, found: LoadFits) -> Score:
    fits, sized = found.fits, found.has_radius
    square, error = fits.parameters[sized, 3], np.sqrt(fits.covariance[sized, 3, 3])
    radii = [radius_of(q, e, u) for q, e, u in zip(square, error, fits.excess[sized], strict=True)]
    value, low, high = np.array([(f.value, f.low, f.high) for f in radii]).T
    return _score(value, cell.radius_mm, bound.radius_stderr_mm, low, high)


def _score(value: Array, truth: float, bound: float, low: Array, high: Array) -> Score:
    inside = (low <= truth) & (truth <= high)
    return Score(
        float(value.std() / bound), float(abs(value.mean() - truth) / bound), float(inside.mean())
    )  # fmt: skip


@lru_cache(maxsize=64)
def estimator_of(diameter_mm: float, known: bool, decibels: int) -> tuple[LoadEstimator, MergedReadings]:
    sensor = load_sensor_type("disc-100mm").value
    readings = merge_reciprocal(sensor.pattern, sensor.pattern.usable(), deviation(decibels) ** 2)
    return LoadEstimator(load_model(sensor), readings, expected_radius_mm=diameter_mm / 2, known=known), readings


@lru_cache(maxsize=8)
def deviation(decibels: int) -> Array:
    return 10 ** (-decibels / 20) * np.abs(load_model(load_sensor_type("disc-100mm").value).solve_unloaded())


@lru_cache(maxsize=64)
def truth(diameter_mm: float, place: Place, contact_mm: float = NOMINAL_CONTACT_MM) -> dict[float, Array]:
    """Changes of all readings (drives, measures) for each contrast, by finite elements.

    Other contacts than the nominal ones change the size of all readings too; as in a run, that is taken out.
    """
    sensor = load_sensor_type("disc-100mm").value
    centre = Cell(diameter_mm, True, 0.0, 0, place).centre_mm
    mesh, inside = fitted_mesh(_mesh(), centre, diameter_mm / 2)
    count = len(mesh.elements)
    contacts = np.full(sensor.electrodes.count, contact_mm)
    plain = ForwardModel(mesh, sensor.pattern, np.ones(count), contacts, order=2)
    unloaded = plain.voltages()
    used, nominal = sensor.pattern.usable(), load_model(sensor).solve_unloaded()
    scale = 1.0
    if contact_mm != NOMINAL_CONTACT_MM:
        scale = float(unloaded[used] @ nominal[used] / (nominal[used] @ nominal[used]))
    return {
        contrast: (plain.with_values(conductance=1 + contrast * inside).voltages() - unloaded) / scale
        for contrast in CONTRASTS
    }


@lru_cache(maxsize=1)
def _mesh() -> Mesh:
    return sheet_mesh(load_sensor_type("disc-100mm").value, size_mm=_MESH_MM)


def all_cells() -> Iterator[Cell]:
    """13 mm with and without the indenter known, 8 and 20 mm without."""
    for diameter_mm, known in ((13.0, True), (13.0, False), (8.0, False), (20.0, False)):
        for place in LARGE_PLACES if diameter_mm > 15 else PLACES:
            for contrast in CONTRASTS:
                for decibels in DECIBELS:
                    yield Cell(diameter_mm, known, contrast, decibels, place)
