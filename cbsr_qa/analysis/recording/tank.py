"""Objects in a tank against a frame of the empty tank: still or moving, with the tank's depth and patterns of balls.

In a tank readings decrease faster with distance than on a sheet, and large balls differ from small ones, because each
electrode senses mainly the nearest part. In a tank as deep as it is wide a sheet's patterns put balls of 0.15 radii
up to 0.04 radii too far out; those of balls of the right size, in the tank, are right within 0.01 up to 0.6.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from cbsr_qa.analysis.recording.imaging import Sheet
from cbsr_qa.analysis.recording.places import Matcher, Place, find_places, fit_loads
from cbsr_qa.domain.goodness import Goodness
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.eit.loads.bodies import DeepTank

_DETECTED = 6.0  #: product of pattern and change, over the noise, from which an object counts
_EXPLAINED = 0.25  #: and the share of the change it must explain
_EXPLAINED_MOVING = 0.15  #: the same while an object is tracked: frames support each other
_BRIDGED_FRAMES = 2  #: frames without the object that do not end its track
_JUMP = 0.4  #: of the radius: a place that far from that of the frame before is of another object


@dataclass(frozen=True, slots=True, eq=False)
class Object:
    """An object, and when it is present.

    Parameters
    ----------
    first, last, peak : frames; ``peak`` is where it is clearest.
    place : place at its peak.
    score : score at its peak, over the noise.
    track : frame and place of every frame it was seen in; a single one for a still image.
    goodness : goodness of the fit at its peak, with all objects of that frame.
    """

    first: int
    last: int
    peak: int
    place: Place
    score: float
    track: tuple[tuple[int, Place], ...]
    goodness: Goodness


def reciprocal_noise(changes: Array, used: Mask, pattern: DrivePattern) -> float:
    """Noise of one reading, from the reciprocity error of changes in a passive tank.

    Parameters
    ----------
    changes : (n, m) changes of the used readings. used : (drives, measures) mask with m True entries.

    Returns
    -------
    Rms over pairs of (y_ij ∓ y_ji)/√2, in the changes' unit; 0 without reciprocal pairs.
    """
    pairs, sign = pattern.reciprocal_pairs()
    both_used = used.ravel()[pairs].all(axis=1)
    if not both_used.any():
        return 0.0
    column = np.cumsum(used.ravel()) - 1
    first, second = column[pairs[both_used]].T
    return float(np.sqrt(np.mean((changes[:, first] - sign[both_used] * changes[:, second]) ** 2) / 2))


def find_still(
    change: Array, match: Matcher, *, noise: str = "the reciprocity error"
) -> tuple[tuple[Object, ...], str]:
    """Find the objects in one still image.

    Parameters
    ----------
    change : (m,) whitened.
    noise : what the noise was estimated from, in words.

    Returns
    -------
    The objects, or why none was found.
    """
    places, explained = find_places(change, match)
    if not places or abs(places[0].score) < _DETECTED or explained < _EXPLAINED:
        score = abs(places[0].score) if places else 0.0
        return (), (
            f"nothing stands out from {noise}: the best place scores {score:.1f}"
            f" (at least {_DETECTED:g} is needed) and explains {explained:.0%} of the change"
            f" (at least {_EXPLAINED:.0%})"
        )
    detected = [place for place in places if abs(place.score) >= _DETECTED]
    goodness = Goodness.from_fit(change, fit_loads(change, match, places), match.sigma, 1.0)
    return tuple(Object(0, 0, 0, place, abs(place.score), ((0, place),), goodness) for place in detected), ""


def find_in_rows(changes: Array, match: Matcher) -> tuple[tuple[Object, ...], str]:
    """Find the objects in frames (n, m), whitened, each for itself; or why none was found in any."""
    objects: list[Object] = []
    reasons = []
    for row, change in enumerate(changes):
        in_row, reason = find_still(change, match, noise="the noise")
        objects += [replace(seen, first=row, last=row, peak=row, track=((row, seen.place),)) for seen in in_row]
        reasons.append(reason)
    return tuple(objects), "" if objects else f"no row shows a load; in the first, {reasons[0]}"


def find_moving(changes: Array, match: Matcher) -> tuple[tuple[Object, ...], str]:
    """Track one object through frames.

    Parameters
    ----------
    changes : (n, m) whitened changes against the empty tank.

    Returns
    -------
    One object per stretch in which it is seen, or why none was found.
    """
    detections: list[tuple[int, Place]] = []
    highest = 0.0
    for k, change in enumerate(changes):
        places, explained = find_places(change, match, most=1)
        if places:
            highest = max(highest, abs(places[0].score))
            if abs(places[0].score) >= _DETECTED and explained >= _EXPLAINED_MOVING:
                detections.append((k, places[0]))
    if not detections:
        return (
            (),
            f"nothing stands out of the noise: the best frame scores {highest:.1f}, at least {_DETECTED:g} is needed",
        )
    stretches: list[list[tuple[int, Place]]] = [[detections[0]]]
    for before, after in pairwise(detections):
        moved = np.hypot(after[1].x - before[1].x, after[1].y - before[1].y)
        if after[0] - before[0] > _BRIDGED_FRAMES + 1 or moved > _JUMP:
            stretches.append([])
        stretches[-1].append(after)
    objects = []
    for stretch in stretches:
        peak, place = max(stretch, key=lambda detection: abs(detection[1].score))
        goodness = Goodness.from_fit(changes[peak], fit_loads(changes[peak], match, (place,)), match.sigma, 1.0)
        first, last = stretch[0][0], stretch[-1][0]
        objects.append(Object(first, last, peak, place, abs(place.score), tuple(stretch), goodness))
    return tuple(objects), ""


_DEPTHS: Final = (0.3, 5.0)  # in radii: shallower is a sheet, deeper makes no difference
_THIN: Final = 0.05  # depth that represents a sheet
_ELECTRODE: Final = 0.1  # width and height of a nominal electrode, of the radius
_EXPLAINED_BY_TANK: Final = 0.05  # deviation of log readings over distances allowed in a tank,
_OF_SHEET: Final = 0.25  # and on a sheet
_FEWEST: Final = 5  # distances between drive and measurement
_SIZES: Final = (0.02, 0.3)  # radii of balls, of the tank's


@dataclass(frozen=True, slots=True, eq=False)
class Tank:
    """A round tank with electrodes at mid-height.

    Parameters
    ----------
    depth : depth in units of the radius.
    """

    depth: float
    field: DeepTank

    def sheet(self, sheet: Sheet, *, ball: float, conducts: bool) -> Sheet:
        """Replace a sheet's patterns with those of balls of a radius (in units of the tank's).

        Signs stay as they are on a sheet: positive for what conducts more.
        """
        used_mask = sheet.problem.used
        reference = self.field.readings()[used_mask]
        changes = self.field.changes(sheet.places, ball, conducts=conducts)[:, used_mask].T * (1 if conducts else -1)
        patterns = changes / reference[:, None] * sheet.problem.reference[:, None]
        return replace(sheet, patterns=patterns)

    def ball_of(self, objects: tuple[Object, ...], sheet: Sheet, change: Array) -> tuple[float, bool]:
        """Radius of the balls, and whether they conduct, from the places and the size of a change.

        They are perfect insulators or conductors, which gives the smallest balls that explain the change.

        Parameters
        ----------
        change : (m,) change of the sheet's readings.
        """
        basis = np.column_stack(
            [
                *(sheet.patterns[:, object_on_sheet.place.index] for object_on_sheet in objects),
                sheet.problem.reference,
            ]
        )
        volume = np.linalg.lstsq(basis, change, rcond=None)[0][:-1]
        radius = float(np.mean(np.cbrt(3 * np.abs(volume) / (4 * np.pi))))
        return min(max(radius, _SIZES[0]), _SIZES[1]), bool(volume.sum() > 0)


def fit_tank(reference: Array, problem: ImagingProblem) -> Tank | None:
    """Fit the depth of a tank to the decay of its reference frame with distance.

    Parameters
    ----------
    reference : (m,), the used readings, of either sign.

    Returns
    -------
    Tank, or None if a sheet explains the readings as well, or a tank does not (channels of unequal gain).
    """
    electrodes, pattern, used_mask = problem.sensor_type.electrodes, problem.sensor_type.pattern, problem.used
    if not isinstance(electrodes, ElectrodeLayout) or pattern.shape[0] != pattern.shape[1]:
        return None
    groups = _distances(pattern, used_mask)
    if len(groups) < _FEWEST:
        return None
    angles = electrodes.angles_rad()

    def decay_spread(depth: float) -> float:
        field = DeepTank(depth, angles, pattern, electrode=_ELECTRODE)
        ratio = np.log(np.abs(reference / field.readings()[used_mask]))
        return float(np.std([np.median(ratio[group]) for group in groups]))

    fit = minimize_scalar(decay_spread, bounds=_DEPTHS, method="bounded", options={"xatol": 1e-3})
    depth = float(fit.x)
    if not float(fit.fun) < min(_EXPLAINED_BY_TANK, _OF_SHEET * decay_spread(_THIN)):
        return None
    return Tank(depth, DeepTank(depth, angles, pattern, electrode=_ELECTRODE))


def _distances(pattern: DrivePattern, used: Mask) -> list[NDArray[np.int64]]:
    """Used readings, counted in order, by the distance round the ring between driven and measured pair."""
    drive, measure = np.nonzero(used)
    count = pattern.electrode_count
    first_electrodes = (
        np.array([pair[0] for pair in pattern.drive])[drive],
        np.array([pair[0] for pair in pattern.measure])[measure],
    )
    steps_apart = (first_electrodes[1] - first_electrodes[0]) % count
    steps_apart = np.minimum(steps_apart, count - steps_apart)
    return [np.flatnonzero(steps_apart == distance) for distance in np.unique(steps_apart)]
