"""Several heads in one frame: number, places and strengths. Numpy alone.

A frame's rows are modelled as the sum of the heads' templates, y = Σ aₖ t(pₖ) + noise. Heads are added while the next
explains more than noise and the template error of a single load (a generalised likelihood ratio): it is searched on
the lattice with the others projected out (orthogonal least squares), then in turn with them, and then places and
strengths of all are fitted by damped Fisher scoring. Two heads so close that one explains both leave little residual,
so splitting a head in several directions is tried too.
"""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.domain.numbers import Array

_STEPS: Final = 25  # steps of scoring; it usually ends earlier
_STILL: Final = 0.01  # change of the squared residuals, in units of a reading's noise, that ends it
_MAX_STEP_MM: Final = 3.0  # step of a place
_TURNS: Final = 4  # rounds of finding each head again with the others fixed
#: Initial distance between halves of a head, of the head's diameter, and number of directions.
_SPLIT_DIAMETERS: Final = 1.3
_DIRECTIONS: Final = 4
#: Heads count as two if each is so many standard errors strong, and their distance is so many of its own.
_RESOLVED: Final = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class Heads:
    """Heads fitted together to one frame.

    Parameters
    ----------
    place_mm, strength : (k, 2) places and (k,) strengths, the strongest in the frame first.
    covariance : (3 k, 3 k) covariance of (strength, x, y) of each in turn, from noise or, if larger, from the
        residual.
    gain : decrease of the squared residuals.
    left : remaining squared residuals over their mean for noise.
    detectability : (k,) strength over its standard error, the places given: the square root of what each adds.
    """

    place_mm: Array
    strength: Array
    covariance: Array
    gain: float
    left: float
    detectability: Array

    def __len__(self) -> int:
        return len(self.strength)

    def groups(self, nearest_mm: float) -> list[list[int]]:
        """Separated heads, and groups of inseparable ones; no two can be closer than ``nearest_mm``."""
        groups = [[number] for number in range(len(self))]
        for other in range(len(self)):
            for first in range(other):
                if not self._are_apart(first, other, nearest_mm):
                    first_group, other_group = (next(g for g in groups if n in g) for n in (first, other))
                    if first_group is not other_group:
                        first_group += other_group
                        groups.remove(other_group)
        return [sorted(group) for group in groups]

    def _are_apart(self, first: int, other: int, nearest_mm: float) -> bool:
        deviation = np.sqrt(np.diag(self.covariance).reshape(-1, 3)[[first, other], 0])
        if (np.abs(self.strength[[first, other]]) < _RESOLVED * deviation).any():
            return False
        displacement_mm = self.place_mm[first] - self.place_mm[other]
        distance = float(np.hypot(*displacement_mm))
        direction = np.zeros(len(self.covariance))
        direction[3 * first + 1 : 3 * first + 3], direction[3 * other + 1 : 3 * other + 3] = (
            displacement_mm,
            -displacement_mm,
        )
        error = float(np.sqrt(max(float(direction @ self.covariance @ direction), 0.0))) / max(distance, 1e-9)
        return distance > _RESOLVED * error and distance + error > nearest_mm

    def times(self, factor: float) -> Self:
        """Heads with strengths in another unit."""
        scale = np.tile([factor, 1.0, 1.0], len(self))
        return replace(self, strength=factor * self.strength, covariance=self.covariance * scale[:, None] * scale)

    def unsure(self, error: Array) -> Self:
        """Heads with additional relative errors (k,) of strengths."""
        variance = np.zeros((len(self), 3))
        variance[:, 0] = (error * self.strength) ** 2
        return replace(self, covariance=self.covariance + np.diag(variance.ravel()))

    def add_scatter(self, size_slope: Array, scatter_mm: float) -> Self:
        """Heads with additional scatter of places beyond noise, as by ``scattered`` for one head."""
        covariance = self.covariance.copy()
        for k, slope in enumerate(size_slope):
            towards = np.vstack([-self.strength[k] * slope, np.eye(2)])
            covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] += scatter_mm**2 * (towards @ towards.T)
        return replace(self, covariance=covariance)

    def sort_by_detectability(self) -> Self:
        """Heads, the most detectable first."""
        order = np.argsort(-self.detectability)
        entries = (3 * order[:, None] + np.arange(3)).ravel()
        return replace(
            self,
            place_mm=self.place_mm[order],
            strength=self.strength[order],
            covariance=self.covariance[np.ix_(entries, entries)],
            detectability=self.detectability[order],
        )


class HeadCounter:
    """Fits as many heads to a frame as it shows.

    Parameters
    ----------
    templates : filter with the templates of the head; all heads are alike.
    threshold : detectability above which a head is not noise.
    misfit : share of a frame's signal, as energy, that a further template may explain without a further head.
    diameter_mm : diameter of the head.
    """

    def __init__(self, templates: TemplateFilter, *, threshold: float, misfit: float, diameter_mm: float) -> None:
        self._filter = templates
        self._least = threshold**2
        self._misfit = misfit
        self._diameter_mm = diameter_mm

    def heads(self, rows: Array, first_mm: Array, at_most: int) -> tuple[Heads | None, float]:
        """Heads in one frame (r,), and the unexplained part, as energy over the explained one.

        Parameters
        ----------
        first_mm : (2,) place of a single head.
        at_most : largest number of heads that are searched for.

        Returns
        -------
        None if no head explains more than noise; 0 if no further head does.
        """
        heads = self._fit(rows, first_mm[None])
        if heads is None or heads.gain < self._least:
            return None, 0.0
        while True:
            more_heads = self._add_head(rows, heads)
            if more_heads is None or more_heads.gain - heads.gain < self._least + self._misfit * heads.gain:
                return heads.sort_by_detectability(), 0.0
            if len(heads) >= at_most:
                return heads.sort_by_detectability(), float(rows @ rows) / heads.gain - 1
            heads = more_heads

    def _add_head(self, rows: Array, heads: Heads) -> Heads | None:
        """The best fit with one more head, from several starts."""
        with_best = np.vstack([heads.place_mm, self._find_best_place(rows, heads.place_mm)])
        starts = [with_best, self._place_in_turn(rows, with_best)]
        angles = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        halves_mm = [
            _SPLIT_DIAMETERS * self._diameter_mm / 2 * np.array([np.cos(angle), np.sin(angle)]) for angle in angles
        ]
        for number, place_mm in enumerate(heads.place_mm):
            others_mm = np.delete(heads.place_mm, number, axis=0)
            splits = [np.vstack([others_mm, place_mm + half_mm, place_mm - half_mm]) for half_mm in halves_mm]
            starts.append(splits[int(np.argmax([self._gain(rows, places) for places in splits]))])
        fits = [fit for fit in (self._fit(rows, places) for places in starts) if fit is not None]
        return max(fits, key=lambda fit: fit.gain, default=None)

    def _place_in_turn(self, rows: Array, places_mm: Array) -> Array:
        """Places on the lattice, each in turn where it explains most besides the others."""
        places = places_mm.copy()
        for _ in range(_TURNS):
            last_places = places.copy()
            for number in range(len(places)):
                places[number] = self._find_best_place(rows, np.delete(places, number, axis=0))
            if np.array_equal(last_places, places):
                break
        return places

    def _find_best_place(self, rows: Array, places_mm: Array) -> Array:
        """Place (2,) on the lattice of the head that explains most besides others, their strengths left free."""
        bank, templates = self._filter.bank, self._filter.template(places_mm)
        basis = np.linalg.qr(templates[np.isfinite(templates).all(axis=1)].T)[0]
        projections = basis.T @ bank
        # Less than the least share is not informative.
        remaining_share = np.maximum(1 - np.einsum("kn,kn->n", projections, projections), 1e-3)
        score = (rows - basis @ (basis.T @ rows)) @ bank
        best: Array = self._filter.searched_mm[int(np.argmax(score**2 / remaining_share))]
        return best

    def _gain(self, rows: Array, places_mm: Array) -> float:
        templates = self._filter.template(places_mm)
        if not np.isfinite(templates).all():
            return -np.inf
        basis = np.linalg.qr(templates.T)[0]
        return float(((basis.T @ rows) ** 2).sum())

    def _fit(self, rows: Array, places_mm: Array) -> Heads | None:
        """Places and strengths of all heads together, from given places; None if no head is possible."""
        places, count = places_mm.copy(), len(places_mm)
        template_jet = self._filter.template_and_slopes(places)
        if not np.isfinite(template_jet).all():
            return None
        strength = _strengths(template_jet, rows)
        residual = rows - strength @ template_jet[:, 0]
        squares, damping = float(residual @ residual), 1e-3
        for _ in range(_STEPS):
            design = _design(template_jet, strength)
            normal = design @ design.T
            try:
                step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), design @ residual).reshape(
                    count, 3
                )
            except np.linalg.LinAlgError:
                return None
            move = step[:, 1:] * np.minimum(1.0, _MAX_STEP_MM / np.maximum(np.hypot(*step[:, 1:].T), 1e-12))[:, None]
            trial_jet = self._filter.template_and_slopes(places + move)
            trial_squares = np.inf
            if np.isfinite(trial_jet).all():
                trial_strength = _strengths(trial_jet, rows)
                trial_residual = rows - trial_strength @ trial_jet[:, 0]
                trial_squares = float(trial_residual @ trial_residual)
            if trial_squares <= squares:
                is_small = squares - trial_squares < _STILL
                places, template_jet, strength, residual, squares = (
                    places + move,
                    trial_jet,
                    trial_strength,
                    trial_residual,
                    trial_squares,
                )
                damping /= 10
                if is_small:
                    break
            elif damping > 1e6:
                break
            else:
                damping *= 10
        return self._heads(rows, places, template_jet, strength, squares)

    def _heads(self, rows: Array, places_mm: Array, at: Array, strength: Array, squares: float) -> Heads | None:
        residual_variance = squares / max(len(rows) - 3 * len(strength), 1)
        try:
            root = _inverse_root(_design(at, strength))
            single_root = _inverse_root(at[:, 0])
        except np.linalg.LinAlgError:
            return None
        gain = float(rows @ rows) - squares
        detectability = np.abs(strength) / np.linalg.norm(single_root, axis=1)
        return Heads(
            places_mm, strength, root @ root.T * max(residual_variance, 1.0), gain, residual_variance, detectability
        )


def _inverse_root(design: Array) -> Array:
    """R⁻¹ (k, k) of the rows of a design (k, r), with (design · designᵀ)⁻¹ = R⁻¹ R⁻ᵀ, by QR of unit rows.

    The product is not formed: for nearly coincident heads it has no correct digits, with negative variances.
    """
    length = np.linalg.norm(design, axis=1)
    if not (length > 0).all():
        raise np.linalg.LinAlgError("a row of the design is zero")
    inverse = np.linalg.inv(np.linalg.qr((design / length[:, None]).T, mode="r"))
    root: Array = inverse / length[:, None]
    return root


def _strengths(at: Array, rows: Array) -> Array:
    return np.asarray(np.linalg.lstsq(at[:, 0].T, rows, rcond=None)[0], dtype=np.float64)


def _design(at: Array, strength: Array) -> Array:
    """Slopes (3 k, r) of the rows with strength, x and y of each head."""
    design = at.copy()
    design[:, 1:] *= strength[:, None, None]
    return design.reshape(-1, at.shape[2])
