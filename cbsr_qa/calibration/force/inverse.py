"""From the strength of one head, or of several, to newtons, with the error of the result. Numpy alone.

κ = 2a/(2 − a) is the relative change of conductance under the head, a its strength; with S the response of the place,
σ = (κ/S − β_σ)/α_σ and F = σ A (paper Eqs 1 and 7, solved for the force of a known head). The variance is that of
four independent causes: noise of the readings (with the place's, where the place was estimated), the map, the scatter
of single loads, and the line. Heads that were fitted together and cannot be separated count as one; the error of
templates for another head size is in :class:`SizeError`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from enum import IntFlag
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.multi_load import Heads
from cbsr_qa.calibration.force.template_matching import Matches
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.calibration import ForceModel, Validity
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic

#: Largest strength; larger ones are limited. Here the sheet conducts 200 times as well under the head.
_STRONGEST = 1.98


class Flag(IntFlag):
    """Remarks on one frame's force or place; 0 for none. ``Flag(33)`` names those of a number."""

    NOT_DETECTED = 1  #: no load exceeds the noise; the force is 0 if the place was not given
    OUTSIDE = 2  #: the place is outside the calibrated area
    BELOW_RANGE = 4  #: the force is below the lightest calibrated load
    ABOVE_RANGE = 8  #: the force is above the heaviest calibrated load
    WRONG_SIGN = 16  #: the place changes the other way than under a load (an unloading spike, or a residue)
    MORE_THAN_ONE = 32  #: the frame is not of one head of the given size
    UNREADABLE = 64  #: more than half of the used readings are lost, or too few are left; there is no force
    OTHER_SENSOR = 128  #: the readings as a whole are not of the calibrated sensor; there is no force
    OTHER_HEAD = 256  #: the head's size differs so much from the calibrated one that its field is off by over 3 %
    NOT_AS_MODELLED = 512  #: no touch of the modelled sheet explains the readings
    SPIKE = 1024  #: a reading was a spike, and its reciprocal, or what the other readings let expect, replaces it
    DEAD_PAIR = 2048  #: a pair hardly drives, or hardly measures: its readings were left out
    OPEN_ELECTRODE = 4096  #: nothing comes through an electrode: its readings were left out
    SATURATED = 8192  #: several readings stood at one extreme value: they were left out
    OFFSET = 16384  #: one offset was added to all readings: it was taken out (a learned place is UNREADABLE)
    MISSING = 32768  #: some readings are not finite numbers: they were left out
    UNSETTLED = 65536  #: followed over time, the load has not settled: its force is a prediction, or remains of one


#: Frames with one of these flags have no force.
NO_FORCE: Final = int(Flag.UNREADABLE | Flag.OTHER_SENSOR)
#: Some readings of frames with one of these flags say nothing of the sheet.
LEFT_OUT: Final = int(Flag.DEAD_PAIR | Flag.OPEN_ELECTRODE | Flag.SATURATED)
_NAMES: Final = {int(flag): str(flag.name).lower() for flag in Flag}


def flag_names(flags: int) -> tuple[str, ...]:
    """Return the names of flags, in lower case."""
    return tuple(name for flag, name in _NAMES.items() if flags & flag)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Forces:
    """One load's force in each of n frames.

    Parameters
    ----------
    force_N, stderr_N : (n,) estimate and its standard error; NaN in frames flagged UNREADABLE or OTHER_SENSOR. For a
        frame flagged MORE_THAN_ONE the error includes the sum of its heads. If a place was searched and no load
        detected, 0 and the least force detectable anywhere in the calibrated area.
    place_mm, place_stderr_mm : (n, 2) place, and (n,) its error, root mean square over two axes; 0 if given. NaN if
        searched in a frame flagged UNREADABLE or OTHER_SENSOR.
    detectability : (n,) d′, the load's signal over the noise of the readings.
    flags : (n,) int64 of :class:`Flag`.
    shared_stderr_N : (n,) part of ``stderr_N`` that all forces of the calibration share (the load cell's), which does
        not average out. 0 where no standard is stated.
    """

    force_N: Array
    stderr_N: Array
    place_mm: Array
    place_stderr_mm: Array
    detectability: Array
    flags: Indices
    shared_stderr_N: Array

    def __repr__(self) -> str:
        detected_N = self.force_N[np.isfinite(self.force_N) & (self.flags & Flag.NOT_DETECTED == 0)]
        force = f", {detected_N.min():.3g} to {detected_N.max():.3g} N" if len(detected_N) else ""
        counts = {flag.name: int(np.count_nonzero(self.flags & flag)) for flag in Flag}
        flagged = "".join(f", {name} in {count}" for name, count in counts.items() if count)
        return f"<Forces in {len(detected_N)} of {len(self.force_N)} frames{force}{flagged}>"

    def part(self, frames: slice) -> "Forces":
        """Forces of some of the frames."""
        return Forces(*(getattr(self, column.name)[frames] for column in fields(Forces)))

    def interval_N(self, coverage: float = 0.95) -> tuple[Array, Array]:
        """Lowest and highest force (n,) of a central interval, normal about the estimate.

        ValueError if the coverage is not between 0 and 1.
        """
        from scipy.special import ndtri

        if not 0 < coverage < 1:
            raise ValueError(f"a coverage of {coverage} is not between 0 and 1")
        half_width_N = float(ndtri((1 + coverage) / 2)) * self.stderr_N
        return self.force_N - half_width_N, self.force_N + half_width_N


def join_forces(parts: Sequence[tuple[Indices, Forces]]) -> Forces:
    """Return forces of some frames each, with their numbers, in the order of the frames."""
    if len(parts) == 1:
        return parts[0][1]
    order = np.argsort(np.concatenate([frames for frames, _ in parts]))
    columns = ([getattr(forces, column.name) for _, forces in parts] for column in fields(Forces))
    return Forces(*(np.concatenate(values)[order] for values in columns))


@dataclass(frozen=True, slots=True, eq=False)
class SeveralForces:
    """All heads in one frame.

    Parameters
    ----------
    loads : forces of k heads, the clearest first; inseparable heads are one entry, flagged MORE_THAN_ONE, with the
        sum of their forces and its error at their middle.
    total_N, total_stderr_N : sum of all forces; 0 and the least detectable force without a head, NaN in unusable
        frames.
    flags : flags of the frame: NOT_DETECTED, UNREADABLE or OTHER_SENSOR without any head, MORE_THAN_ONE if heads were
        not separated or there are more than searched for, SPIKE; else none.
    """

    loads: Forces
    total_N: float
    total_stderr_N: float
    flags: Flag


class Newtons(NamedTuple):
    """Forces (n,) [N], slopes (n, 3) with strength, x and y, and the variance (n,) by map, scatter and line."""

    force: Array
    slope: Array
    variance: Array


@dataclass(frozen=True, slots=True, eq=False)
class ForceInverse:
    """The inverse of one sensor and head.

    Parameters
    ----------
    model : force model of the sensor.
    line : α_σ [1/kPa] and β_σ with their covariance, that of the line through the calibrated stresses; shared errors
        are in the map.
    area_mm2 : area of the head.
    tables : (nodes, 4) values of the map, see :func:`map_tables`.
    """

    model: ForceModel
    line: QuasiStatic
    area_mm2: float
    tables: Array

    def force(self, matches: Matches) -> tuple[Array, Array]:
        """Force and standard error (n,) [N]; NaN if the place has no map."""
        newtons = self.newtons(matches)
        slope = newtons.slope[:, None]
        by_readings = (slope @ matches.covariance @ slope.transpose(0, 2, 1))[:, 0, 0]
        return newtons.force, np.sqrt(np.maximum(by_readings, 0.0) + newtons.variance)

    def strength(self, force_N: Array, places_mm: Array) -> Array:
        """Strengths (n,) that forces (n,) [N] have at places (n, 2), the inverse of :meth:`newtons`."""
        response = np.exp(interpolate(self.model, self.tables, places_mm)[:, 0])
        relative = self.line.slope.value * force_N / self.area_mm2 * 1e3 + self.line.intercept.value
        strength: Array = 2 * relative * response / (2 + relative * response)
        return strength

    def newtons(self, matches: Matches) -> Newtons:
        """Forces (n,). A strength near 2 or above, which is unphysical, counts as a force far above any range."""
        model, strength = self.model, np.minimum(matches.strength, _STRONGEST)
        mapped = interpolate(model, self.tables, matches.place_mm)
        log_response, stderr, slope = mapped[:, 0], mapped[:, 1], mapped[:, 2:]
        response = np.exp(-log_response)
        relative = 2 * strength / (2 - strength) * response
        alpha, beta = self.line.slope.value, self.line.intercept.value
        stress = (relative - beta) / alpha
        towards = np.empty((len(strength), 3))
        towards[:, 0] = 4 / (2 - strength) ** 2 * response
        towards[:, 1:] = -relative[:, None] * slope
        by_map = relative**2 * (stderr**2 + model.scatter**2)
        scale = self.area_mm2 / 1e3
        per = scale / alpha
        return Newtons(stress * scale, towards * per, (by_map + self.line.variance(stress)) * per**2)


def least_force_N(inverse: ForceInverse, size: Array, places_mm: Array) -> Array:
    """Force (n,) whose change of one frame just counts as a load, by size (n,) of a change per strength at places."""
    strength = np.sign(inverse.line.slope.value) * inverse.model.threshold / size
    nothing = np.zeros(len(size))
    force, _ = inverse.force(Matches(places_mm, strength, np.zeros((len(size), 3, 3)), nothing, nothing))
    return np.maximum(force, 0.0)


def map_tables(model: ForceModel) -> Array:
    """Map (nodes, 4): ln S, its standard error, and its gradient along x and y [1/mm]."""
    node, values = model.node, model.log_response
    padded = np.pad(node, 1, constant_values=-1)
    row, column = np.nonzero(node >= 0)
    node_index = padded[row + 1, column + 1]
    gradient = np.zeros((len(values), 2))
    for axis, (down, across) in enumerate(((0, 1), (1, 0))):
        ahead, behind = padded[row + 1 + down, column + 1 + across], padded[row + 1 - down, column + 1 - across]
        both_mask = (ahead >= 0) & (behind >= 0)
        difference = values[ahead] - values[behind]
        gradient[node_index, axis] = np.where(both_mask, difference / (2 * model.lattice.spacing_mm), 0.0)
    return np.column_stack([values, model.log_response_stderr, gradient])


def range_flags(force_N: Array, stderr_N: Array, place_mm: Array, validity: Validity) -> Indices:
    """Flags (n,) of forces and places outside the calibrated range, with a margin of one standard error of force."""
    distance = np.hypot(place_mm[:, 0], place_mm[:, 1])
    flags: Indices = ~(distance <= validity.radius_mm) * int(Flag.OUTSIDE)
    if validity.force_N is not None:
        lowest, highest = validity.force_N
        flags |= (force_N + stderr_N < lowest) * int(Flag.BELOW_RANGE)
        flags |= (force_N - stderr_N > highest) * int(Flag.ABOVE_RANGE)
    return flags


#: Relative error of a strength over (q − 1)², q the squared radius over the calibrated one's: everywhere, and times
#: the cube of the calibrated radius over the distance to the nearest edge or electrode. Templates are linear in q;
#: this is the next order, measured on the 100 mm disc with heads of 5 to 40 mm, up to 38 mm from the centre.
_EVERYWHERE: Final = 4e-4
_BESIDE_EDGES: Final = 0.1
#: Distance of the lattice's nodes from edges and electrodes [of the lattice's spacing].
_FIRST_NODE: Final = 1.2
#: Relative error above which a force is flagged.
LARGEST: Final = 0.03


class SizeError:
    """Errors of heads of other sizes.

    Parameters
    ----------
    model : force model of the sensor.
    radius_mm : radius of the calibrated head.
    """

    def __init__(self, model: ForceModel, radius_mm: float) -> None:
        self._model = model
        self._radius_mm = radius_mm

    def __call__(self, size: float, places_mm: Array) -> Array:
        """Relative standard error (n,) of strengths at places (n, 2); ``size`` is relative, of the squared radius."""
        if size == 1:
            return np.zeros(len(places_mm))
        lattice = self._model.lattice
        position = (np.nan_to_num(places_mm) - np.array(lattice.origin_mm)) / lattice.spacing_mm
        column, row = np.clip(np.rint(position), 0, [lattice.columns - 1, lattice.rows - 1]).astype(np.int64).T
        edge_term = (self._radius_mm / self._clearance_mm[row, column]) ** 3
        error: Array = (size - 1) ** 2 * (_EVERYWHERE + _BESIDE_EDGES * edge_term)
        return error

    @cached_property
    def _clearance_mm(self) -> Array:
        """Distance (rows, columns) to the nearest edge or electrode, inferred from missing nodes."""
        from scipy.ndimage import distance_transform_edt  # rarely needed: heads are usually the calibrating ones

        nodes = np.pad(self._model.node >= 0, 1)
        steps = np.asarray(distance_transform_edt(nodes), dtype=np.float64)[1:-1, 1:-1]
        return (np.maximum(steps - 1, 0.0) + _FIRST_NODE) * self._model.lattice.spacing_mm


#: Contribution of undetected heads to a sum, over the root of their share of the signal: where the sheet responds
#: weakly, heads press harder than they seem to.
_MISSING: Final = 2.0


def forces_together(
    heads: Heads,
    unexplained: float,
    inverse: ForceInverse,
    validity: Validity,
    *,
    nearest_mm: float,
    sign: float,
    other_head: Mask,
) -> SeveralForces:
    """Forces of the heads in one frame.

    Parameters
    ----------
    heads : heads of the frame, with the strengths of the inverse's head.
    unexplained : share of the frame's signal, as energy, that further heads explain, or 0.
    nearest_mm : least distance of heads that are separated.
    sign : sign of the response.
    other_head : (k,) mask of heads whose templates have a larger error than is allowed.
    """
    covariance = np.array([heads.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(len(heads))])
    energy = heads.detectability**2
    newtons = inverse.newtons(Matches(heads.place_mm, heads.strength, covariance, energy, energy))
    groups = heads.groups(nearest_mm)
    sums = [_sum_group(heads, newtons, group) for group in groups]
    force, stderr, place, place_stderr = (np.array(values) for values in zip(*sums, strict=True))
    missing_share = _MISSING * np.sqrt(unexplained)
    stderr = np.hypot(stderr, missing_share * np.abs(force))
    flags = range_flags(force, stderr, place, validity)
    together_mask = np.array([len(group) > 1 for group in groups]) | (unexplained > 0)
    flags[together_mask] |= Flag.MORE_THAN_ONE
    flags[np.array([heads.strength[group].sum() * sign < 0 for group in groups])] |= Flag.WRONG_SIGN
    flags[np.array([other_head[group].any() for group in groups])] |= Flag.OTHER_HEAD
    detectability = np.array([heads.detectability[group].max() for group in groups])
    loads = Forces(force, stderr, place, place_stderr, detectability, flags, np.zeros(len(force)))
    total, total_stderr, _, _ = _sum_group(heads, newtons, range(len(heads)))
    frame_flags = Flag.MORE_THAN_ONE if together_mask.any() else Flag(0)
    return SeveralForces(loads, total, float(np.hypot(total_stderr, missing_share * abs(total))), frame_flags)


def make_empty_frame(total_N: float, stderr_N: float, flags: Flag) -> SeveralForces:
    """A frame without any head."""
    none, places = np.zeros(0), np.zeros((0, 2))
    loads = Forces(none, none, places, none, none, np.zeros(0, dtype=np.int64), none)
    return SeveralForces(loads, total_N, stderr_N, flags)


def _sum_group(heads: Heads, newtons: Newtons, group: Sequence[int]) -> tuple[float, float, Array, float]:
    """Sum of some heads' forces with its error, and their force-weighted middle with its error."""
    head_indices = np.array(group)
    entries = (3 * head_indices[:, None] + np.arange(3)).ravel()
    covariance = heads.covariance[np.ix_(entries, entries)]
    slope = newtons.slope[head_indices].ravel()
    shared = float(np.sqrt(newtons.variance[head_indices]).sum())
    stderr = float(np.hypot(np.sqrt(max(float(slope @ covariance @ slope), 0.0)), shared))
    force = newtons.force[head_indices]
    weight = np.abs(force) / np.abs(force).sum()
    middle: Array = weight @ heads.place_mm[head_indices]
    spread = weight @ ((heads.place_mm[head_indices] - middle) ** 2).sum(axis=1)
    places = [covariance[3 * k + axis, 3 * k + axis] for k in range(len(head_indices)) for axis in (1, 2)]
    variance = weight @ np.array(places).reshape(-1, 2).sum(axis=1)
    return float(force.sum()), stderr, middle, float(np.sqrt((variance + spread) / 2))
