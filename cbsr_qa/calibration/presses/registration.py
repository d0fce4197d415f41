"""Pose of a sheet in the frame of its labelled presses: rotation, mirror, scale and shift by maximum likelihood.

Each press gives a likelihood map over the modelled sheet. The similarity maximises the likelihood of all presses
together: found on a lattice of similarities, then refined. Standard errors are by bootstrap over the presses.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from cbsr_qa.calibration.presses.likeness import Likeness, alikeness, answering_side
from cbsr_qa.calibration.presses.weak_loads import ModelledSheet
from cbsr_qa.domain import Array, Indices, NumericsError
from cbsr_qa.domain.results import SheetRegistration

Complex = NDArray[np.complex128]

#: Presses for the search over the lattice of similarities, and for the refinement; evenly spread over all.
_SEARCHED, _REFINED = 60, 300
#: Fewer different places do not determine a similarity and its errors.
FEWEST_PLACES: Final = 4
#: Smaller second over first singular value of the places: they lie on a line.
_LINE: Final = 0.02
#: Relative uncertainty of a stated radius: sheets are stretched when mounted.
_RADIUS_ERROR: Final = 0.1
#: Standard error of the logarithm of the scale beside that of a bootstrap: the size of the head is not known, and a
#: large one seems to press nearer the centre. On a simulated disc of 100 mm, whose model is exact, forty presses
#: are found 0.4 % too far out with a head of 4 mm, as they are with 8 mm, and 1.4 and 3 % too near with 13 and 18 mm.
_HEAD_ERROR: Final = 0.02
#: Lattice of similarities: rotations, sizes of a radius and shifts, both of the presses' own radius.
_ROTATIONS: Final = np.radians(np.arange(0.0, 360.0, 10.0))
_SIZES: Final = np.geomspace(0.95, 4.0, 13)
_SHIFTS: Final = np.array([x + 1j * y for x in (-0.4, -0.2, 0, 0.2, 0.4) for y in (-0.4, -0.2, 0, 0.2, 0.4)])
#: Candidates of each mirror and sign that are refined, and the size of a first step in (x, y, rotation, log size).
_CANDIDATES: Final = 3
_STEP: Final = np.array([0.1, 0.1, 0.15, 0.1])
_BOOTSTRAPS, _SEED = 40, 22
#: Shares of the spread of places and of the readings' changes that a trusted modelled sheet must explain, and log
#: likelihood by which its mirror image must be less likely.
_LEAST_SHARE: Final = 0.5
_LEAST_SIGNAL: Final = 0.15
_LEAST_EVIDENCE: Final = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Registered:
    """A registration with its basis.

    Parameters
    ----------
    registration : the similarity.
    sign : factor of changes for the sign of a rise of conductance.
    places : (n, 2) of all presses on the sheet, in radii.
    likelihood : log likelihood of the presses used in the refinement.
    findings : on the readings, in words.
    """

    registration: SheetRegistration
    sign: int
    places: Array
    likelihood: float
    findings: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    """Similarity z ↦ conj?((z − x − iy) e^(−iθ)/size), from the presses' frame to radii of the sheet."""

    mirrored: bool
    numbers: Array  # x, y [mm], θ [rad], log of the length of a radius [mm]

    def places(self, labelled: Complex) -> Array:
        """Places (n, 2) on the sheet."""
        x, y, angle, size = self.numbers
        z = (labelled - x - 1j * y) * np.exp(-1j * angle - size)
        return np.stack([z.real, -z.imag if self.mirrored else z.imag], axis=-1)

    def labelled(self, places: Array) -> Complex:
        """Labels (n,) of places (n, 2) on the sheet."""
        x, y, angle, size = self.numbers
        z: Complex = _complex(places * [1, -1] if self.mirrored else places) * np.exp(1j * angle + size) + x + 1j * y
        return z


def register_presses(
    sheet: ModelledSheet, pairs: Indices, changes: Array, place_mm: Array, *, radius_stated: bool
) -> Registered:
    """Register a sheet to its labelled presses.

    Parameters
    ----------
    sheet : as modelled; without a stated radius its own does not matter.
    pairs : (m, 4) source, sink, plus and minus of the readings.
    changes : (n, m) by each press, any unit.
    place_mm : (n, 2) labels of the presses.
    radius_stated : True if the sheet's radius is known and the scale estimated; False to estimate the radius at a
        scale of 1.

    Raises
    ------
    NumericsError
        If the places do not determine a similarity: too few, all at one place, or all on a line.
    """
    check_places(place_mm)
    side = answering_side(sheet, pairs, changes)
    pairs, changes = pairs[side.answers], changes[:, side.answers]
    stated_mm = sheet.radius_mm if radius_stated else None
    chosen = evenly_spread(len(changes), _REFINED)
    search = _Search(place_mm[chosen], stated_mm)
    likeness = {sign: Likeness(sheet, pairs, sign * changes[chosen]) for sign in (1, -1)}
    cases = [(sign, mirrored) for sign in likeness for mirrored in (False, True)]
    best = {case: search.best(likeness[case[0]], mirrored=case[1]) for case in cases}
    sign, mirrored = max(best, key=lambda case: best[case][1])
    pose, value = best[sign, mirrored]
    seen = pose.labelled(likeness[sign].best_places())
    places = pose.places(_complex(place_mm))
    registration = _registration(
        pose,
        search.errors(likeness[sign], pose),
        stated_mm,
        place_share=_place_share(seen, search.labelled),
        signal_share=_signal_share(sheet, pairs, sign * changes, places),
        evidence=value - max(best[other, not mirrored][1] for other in likeness),
    )
    return Registered(registration, sign, places, value, (side.words,) if side.words else ())


def turned_likelihood(
    sheet: ModelledSheet, pairs: Indices, changes: Array, place_mm: Array, near: SheetRegistration
) -> float:
    """Largest log likelihood of presses with the centre and size of a registration, over all rotations and mirrors.

    Parameters and errors as for :func:`register_presses`.
    """
    side = answering_side(sheet, pairs, changes)
    size = np.log(near.radius_mm * near.scale)
    turned = (_complex(place_mm) - complex(*near.shift_mm)) * np.exp(-size - 1j * _ROTATIONS)[:, None]
    values = []
    for sign in (1, -1):
        likeness = Likeness(sheet, pairs[side.answers], sign * changes[:, side.answers])
        for each in (turned, turned.conj()):
            values.append(float(likeness.roughly(np.stack([each.real, each.imag], axis=-1)).sum(axis=1).max()))
    return max(values)


def check_places(place_mm: Array) -> None:
    """Check that labelled places (n, 2) determine a similarity; NumericsError if not."""
    different = np.unique(place_mm, axis=0)
    if len(different) == 1:
        raise NumericsError(
            f"all {len(place_mm)} presses are at one place, ({different[0, 0]:g}, {different[0, 1]:g}) mm",
            remedy="press at places all over the sheet",
        )
    if len(different) < FEWEST_PLACES:
        raise NumericsError(
            f"presses at {len(different)} different places do not determine how the sheet lies",
            remedy=f"press at {FEWEST_PLACES} places or more, better nine",
        )
    singular = np.linalg.svd(different - different.mean(axis=0), compute_uv=False)
    if singular[1] < _LINE * singular[0]:
        raise NumericsError(
            "all presses are on one line: they do not show whether the sheet is mirrored",
            remedy="press at places to both sides of the line too",
        )


def evenly_spread(count: int, most: int) -> Indices:
    """Indices of a limited number of presses, spread evenly over all."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


class _Search:
    """Search for the most likely pose.

    Parameters
    ----------
    place_mm : (n, 2) labels of the presses.
    stated_mm : the sheet's radius, or None if unknown.
    """

    def __init__(self, place_mm: Array, stated_mm: float | None) -> None:
        self.labelled = _complex(place_mm)
        self._stated_mm = stated_mm
        self._radius_off = 0.0  # of the logarithm, in a bootstrap: the stated radius is not exact either
        low, high = place_mm.min(axis=0), place_mm.max(axis=0)
        self._middle = complex(*((low + high) / 2))
        self._reach = float(np.abs(self.labelled - self._middle).max())
        self._steps = np.array([self._reach, self._reach, 1.0, 1.0]) * _STEP

    def best(self, likeness: Likeness, *, mirrored: bool) -> tuple[_Pose, float]:
        refined = (self._refined(likeness, pose) for pose in self._candidates(likeness, mirrored=mirrored))
        return max(refined, key=lambda found: found[1])

    def errors(self, likeness: Likeness, pose: _Pose) -> Array:
        """Standard errors (4,) of a pose's parameters, by bootstrap over places and radius, and for the head's size.

        All presses at one place are drawn together, since they share the sheet's deviation from its model.
        """
        _, place = np.unique(self.labelled, return_inverse=True)
        count, random = int(place.max()) + 1, np.random.default_rng(_SEED)
        draws = (random.integers(count, size=count) for _ in range(_BOOTSTRAPS))
        drawn = []
        for draw in draws:
            self._radius_off = _RADIUS_ERROR * random.standard_normal()
            times = np.bincount(draw, minlength=count)[place]
            drawn.append(self._refined(likeness, pose, times)[0].numbers)
        low, high = np.quantile(np.array(drawn) - pose.numbers, [0.16, 0.84], axis=0)
        half: Array = (high - low) / 2
        half[3] = np.hypot(half[3], _HEAD_ERROR)
        return half

    def _candidates(self, likeness: Likeness, *, mirrored: bool) -> list[_Pose]:
        some = evenly_spread(len(self.labelled), _SEARCHED)
        fewer, labelled = likeness.of(some), self.labelled[some]
        sizes, shifts = np.log(_SIZES * self._reach), _SHIFTS * self._reach + self._middle
        values = np.empty((len(sizes), len(shifts), len(_ROTATIONS)))
        for i, size in enumerate(sizes):
            for j, shift in enumerate(shifts):
                turned = (labelled - shift) * np.exp(-size - 1j * _ROTATIONS)[:, None]
                places = np.stack([turned.real, -turned.imag if mirrored else turned.imag], axis=-1)
                values[i, j] = fewer.roughly(places).sum(axis=1) + self._prior(size)
        best = np.argsort(values, axis=None)[::-1][::_CANDIDATES][:_CANDIDATES]
        chosen = zip(*np.unravel_index(best, values.shape), strict=True)
        return [
            _Pose(mirrored, np.array([shifts[j].real, shifts[j].imag, _ROTATIONS[k], sizes[i]])) for i, j, k in chosen
        ]

    def _refined(self, likeness: Likeness, pose: _Pose, times: Indices | None = None) -> tuple[_Pose, float]:
        """Refine a pose; ``times`` (n,) is the weight of each press."""
        weight = np.ones(len(self.labelled)) if times is None else times

        def unlikely(steps: Array) -> float:
            numbers = pose.numbers + steps * self._steps
            places = _Pose(pose.mirrored, numbers).places(self.labelled)
            return -float(likeness.at(places) @ weight + self._prior(numbers[3]))

        start = np.vstack([np.zeros(4), np.eye(4)])
        found = minimize(
            unlikely,
            np.zeros(4),
            method="Nelder-Mead",
            options={"maxiter": 250, "xatol": 1e-2, "fatol": 1e-3, "initial_simplex": start},
        )
        return _Pose(pose.mirrored, pose.numbers + found.x * self._steps), -float(found.fun)

    def _prior(self, size: float) -> float:
        if self._stated_mm is None:
            return 0.0
        away = float(size - np.log(self._stated_mm) - self._radius_off) / _RADIUS_ERROR
        return -2 * float(np.log1p(away**2 / 4))  # Student's t: presses may contradict the stated radius


def _registration(
    pose: _Pose, errors: Array, stated_mm: float | None, *, place_share: float, signal_share: float, evidence: float
) -> SheetRegistration:
    x, y, angle, log_size = pose.numbers.tolist()
    size, size_error = float(np.exp(log_size)), float(np.exp(log_size) * errors[3])
    why = _doubts(place_share, signal_share, evidence)
    return SheetRegistration(
        rotation_deg=float((np.degrees(angle) + 180) % 360 - 180),
        rotation_stderr_deg=float(np.degrees(errors[2])),
        mirrored=pose.mirrored,
        scale=1.0 if stated_mm is None else size / stated_mm,
        scale_stderr=0.0 if stated_mm is None else size_error / stated_mm,
        shift_mm=(x, y),
        shift_stderr_mm=(float(errors[0]), float(errors[1])),
        radius_mm=size if stated_mm is None else stated_mm,
        radius_stderr_mm=size_error if stated_mm is None else 0.0,
        place_share=place_share,
        signal_share=signal_share,
        trusted=not why,
        why=why,
    )


def _doubts(place_share: float, signal_share: float, evidence: float) -> str:
    """Why the modelled sheet does not determine this one's pose; empty if it does."""
    if place_share < _LEAST_SHARE:
        return (
            f"the modelled sheet explains {max(place_share, 0.0):.0%} of the spread of the presses' places,"
            f" {_LEAST_SHARE:.0%} is needed: this sheet is not what the sensor type describes"
        )
    if signal_share < _LEAST_SIGNAL:
        return (
            f"the modelled sheet explains {signal_share:.0%} of the readings' changes; {_LEAST_SIGNAL:.0%} is needed:"
            " this sheet is not what the sensor type describes"
        )
    if evidence < _LEAST_EVIDENCE:
        return (
            f"the mirrored sheet is nearly as likely: its log likelihood is lower by {evidence:.2g}, and"
            f" {_LEAST_EVIDENCE:g} is needed"
        )
    return ""


def _place_share(seen: Complex, labelled: Complex) -> float:
    """Share of the spread of places explained by an estimate, by medians of squared distances."""
    apart = np.abs(labelled - np.median(labelled.real) - 1j * np.median(labelled.imag))
    return 1 - float(np.median(np.abs(seen - labelled) ** 2) / np.median(apart**2))


def _signal_share(sheet: ModelledSheet, pairs: Indices, changes: Array, places: Array) -> float:
    """Share of the changes' energy explained by a load at its place, median over the presses on the sheet."""
    inside = sheet.clear(places)
    if not inside.any():
        return 0.0
    chosen = np.flatnonzero(inside)[evenly_spread(int(inside.sum()), _REFINED)]
    alike = alikeness(changes[chosen], sheet.loads(places[chosen]).readings(pairs))
    return float(np.median(np.maximum(alike, 0.0) ** 2))


def _complex(places: Array) -> Complex:
    z: Complex = places @ np.array([1, 1j])
    return z
