"""The most likely pose of a sheet among its labelled presses, and its standard errors.

It is searched for on a lattice of poses, then refined. Standard errors are by bootstrap over the presses.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.place.held_out import evenly
from cbsr_qa.calibration.presses.ascent import ascend
from cbsr_qa.calibration.presses.likeness import Likeness
from cbsr_qa.domain.numbers import Array, Indices

Complex = NDArray[np.complex128]

#: Presses for the search over the lattice; evenly spread over all.
_SEARCHED: Final = 60
#: Relative uncertainty of a stated radius: sheets are stretched when mounted.
_RADIUS_ERROR: Final = 0.1
#: Standard error of the logarithm of the scale beside that of a bootstrap: the size of the head is not known, and a
#: large one seems to press nearer the centre. On a simulated disc of 100 mm, whose model is exact, forty presses
#: are found 0.4 % too far out with a head of 4 mm, as they are with 8 mm, and 1.4 and 3 % too near with 13 and 18 mm.
_HEAD_ERROR: Final = 0.02
#: Lattice of similarities: rotations, sizes of a radius and shifts, both of the presses' own radius.
ROTATIONS: Final = np.radians(np.arange(0.0, 360.0, 10.0))
_SIZES: Final = np.geomspace(0.95, 4.0, 13)
_SHIFTS: Final = np.array([x + 1j * y for x in (-0.4, -0.2, 0, 0.2, 0.4) for y in (-0.4, -0.2, 0, 0.2, 0.4)])
#: Candidates of each mirror and sign that are refined, and the size of a first step in (x, y, rotation, log size).
_CANDIDATES: Final = 3
_STEP: Final = np.array([0.1, 0.1, 0.15, 0.1])
#: Starts of a refinement about a pose, in first steps: near the rim likelihoods have many maxima.
_STARTS: Final = np.vstack([np.zeros(4), np.eye(4)])
_BOOTSTRAPS, _SEED = 40, 22


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Similarity z ↦ conj?((z − x − iy) e^(−iθ)/size), from the presses' frame to radii of the sheet."""

    mirrored: bool
    numbers: Array  # x, y [mm], θ [rad], log of the length of a radius [mm]

    def places(self, labelled: Complex) -> Array:
        """Places (n, 2) on the sheet."""
        x, y, angle, size = self.numbers
        z = (labelled - x - 1j * y) * np.exp(-1j * angle - size)
        return np.stack([z.real, -z.imag if self.mirrored else z.imag], axis=-1)

    def to_labels(self, places: Array) -> Complex:
        """Labels (n,) of places (n, 2) on the sheet."""
        x, y, angle, size = self.numbers
        z: Complex = (
            to_complex(places * [1, -1] if self.mirrored else places) * np.exp(1j * angle + size) + x + 1j * y
        )
        return z


class PoseSearch:
    """Search for the most likely pose.

    Parameters
    ----------
    place_mm : (n, 2) labels of the presses.
    stated_mm : the sheet's radius, or None if unknown.
    """

    def __init__(self, place_mm: Array, stated_mm: float | None) -> None:
        self.labelled = to_complex(place_mm)
        self._stated_mm = stated_mm
        low, high = place_mm.min(axis=0), place_mm.max(axis=0)
        self._middle = complex(*((low + high) / 2))
        self._reach = float(np.abs(self.labelled - self._middle).max())
        self._steps = np.array([self._reach, self._reach, 1.0, 1.0]) * _STEP

    def best(self, likeness: Likeness, *, mirrored: bool) -> tuple[Pose, float]:
        """The most likely pose that was found, and its log likelihood."""
        starts = self._candidates(likeness, mirrored=mirrored)
        numbers, values = self._refine(likeness, starts, mirrored=mirrored)
        return Pose(mirrored, numbers[values.argmax()]), float(values.max())

    def errors(self, likeness: Likeness, pose: Pose) -> Array:
        """Standard errors (4,) of a pose's parameters, by bootstrap over places and radius, and for the head's size.

        All presses at one place are drawn together, since they share the sheet's deviation from its model.
        """
        _, place = np.unique(self.labelled, return_inverse=True)
        count, random = int(place.max()) + 1, np.random.default_rng(_SEED)
        times, radius_off = np.empty((_BOOTSTRAPS, len(place))), np.empty(_BOOTSTRAPS)
        for draw in range(_BOOTSTRAPS):
            times[draw] = np.bincount(random.integers(count, size=count), minlength=count)[place]
            radius_off[draw] = _RADIUS_ERROR * random.standard_normal()
        starts = np.tile(pose.numbers, (_BOOTSTRAPS, 1))
        drawn = self._refine(likeness, starts, mirrored=pose.mirrored, times=times, radius_off=radius_off)[0]
        low, high = np.quantile(drawn - pose.numbers, [0.16, 0.84], axis=0)
        half_width: Array = (high - low) / 2
        half_width[3] = np.hypot(half_width[3], _HEAD_ERROR)
        return half_width

    def _candidates(self, likeness: Likeness, *, mirrored: bool) -> Array:
        """Numbers (k, 4) of the poses on the lattice to begin from."""
        searched_presses = evenly(len(self.labelled), _SEARCHED)
        searched_likeness, labelled = likeness.select(searched_presses), self.labelled[searched_presses]
        sizes, shifts = np.log(_SIZES * self._reach), _SHIFTS * self._reach + self._middle
        values = np.empty((len(sizes), len(shifts), len(ROTATIONS)))
        for i, length in enumerate(sizes):
            for j, centre in enumerate(shifts):
                turned = (labelled - centre) * np.exp(-length - 1j * ROTATIONS)[:, None]
                places = np.stack([turned.real, -turned.imag if mirrored else turned.imag], axis=-1)
                values[i, j] = searched_likeness.approximate(places).sum(axis=1) + self._prior(length)[0]
        best = np.argsort(values, axis=None)[::-1][::_CANDIDATES][:_CANDIDATES]
        size, shift, rotation = np.unravel_index(best, values.shape)
        starts: Array = np.column_stack([shifts[shift].real, shifts[shift].imag, ROTATIONS[rotation], sizes[size]])
        return starts

    def _refine(
        self,
        likeness: Likeness,
        starts: Array,
        *,
        mirrored: bool,
        times: Array | None = None,
        radius_off: Array | None = None,
    ) -> tuple[Array, Array]:
        """Refine poses (k, 4), the best from several starts about each: numbers (k, 4) and log likelihoods (k,).

        Parameters
        ----------
        times : (k, n) weight of each press.
        radius_off : (k,) errors of the logarithm of the stated radius.
        """
        weights = np.ones((len(starts), len(self.labelled))) if times is None else times
        radius_offset = np.zeros(len(starts)) if radius_off is None else radius_off

        def jet(steps: Array, which: Indices) -> tuple[Array, Array, Array]:
            which = which // len(_STARTS)
            numbers, weight = starts[which] + steps * self._steps, weights[which]
            places, place_slopes = self._place_presses(numbers, mirrored=mirrored)
            likelihood, x, y, xx, xy, yy = weight * likeness.evaluate(places)
            value, slope, bend = self._prior(numbers[:, 3] - radius_offset[which])
            along, across = (self._steps * part for part in place_slopes)
            slopes = (x[:, None] @ along + y[:, None] @ across)[:, 0]
            bends = along.swapaxes(1, 2) @ (xx[..., None] * along + xy[..., None] * across)
            bends += across.swapaxes(1, 2) @ (xy[..., None] * along + yy[..., None] * across)
            slopes[:, 3] += self._steps[3] * slope
            bends[:, 3, 3] += self._steps[3] ** 2 * bend
            return likelihood.sum(axis=1) + value, slopes, bends

        steps, values = ascend(jet, np.tile(_STARTS, (len(starts), 1)))
        best = values.reshape(-1, len(_STARTS)).argmax(axis=1) + len(_STARTS) * np.arange(len(starts))
        return starts + steps[best] * self._steps, values[best]

    def _place_presses(self, numbers: Array, *, mirrored: bool) -> tuple[Array, tuple[Array, Array]]:
        """Places (k, n, 2) of the presses in poses (k, 4), and how x and y move with their numbers (k, n, 4).

        Second derivatives are left out of bends: where slopes sum to zero, theirs do.
        """
        x, y, angle, size = numbers.T[..., None]
        factor = np.exp(-1j * angle - size)
        z = (self.labelled - x - 1j * y) * factor
        factor = np.broadcast_to(factor, z.shape)
        derivatives = np.stack([-factor, -1j * factor, -1j * z, -z], axis=-1)
        if mirrored:
            z, derivatives = z.conj(), derivatives.conj()
        return np.stack([z.real, z.imag], axis=-1), (derivatives.real, derivatives.imag)

    def _prior(self, size: Array) -> tuple[Array, Array, Array]:
        """Log likelihood (k,) of the logarithm of a size, its slope and its bend.

        Student's t: presses may contradict the stated radius.
        """
        if self._stated_mm is None:
            none = np.zeros_like(size)
            return none, none, none
        deviation = (size - np.log(self._stated_mm)) / _RADIUS_ERROR
        spread = 1 + deviation**2 / 4
        slope = -deviation / spread / _RADIUS_ERROR
        return -2 * np.log(spread), slope, (deviation**2 / 4 - 1) / spread**2 / _RADIUS_ERROR**2


def to_complex(places: Array) -> Complex:
    """Places (…, 2) as complex numbers."""
    z: Complex = places @ np.array([1, 1j])
    return z
