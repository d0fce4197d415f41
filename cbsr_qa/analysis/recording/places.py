"""Template matching: the place whose small-load pattern fits a change best.

For one small load in Gaussian noise the place whose unit-length whitened pattern has the largest product with the
whitened change is the maximum-likelihood estimate; unlike the maximum of a regularised image it is not drawn outward
by the prior. Several loads are found one after the other (orthogonal matching pursuit), then refined in turn on the
residual of the others.
"""

from dataclasses import dataclass, replace

import numpy as np

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA
from cbsr_qa.domain.goodness import LEAST_EXPLAINED
from cbsr_qa.domain.numbers import Array

#: A further load must explain this share of the whole change, and of what the first one explains.
_FURTHER_SHARE = 0.15
_FURTHER_OF_FIRST = 0.35
#: A load far from the others does not explain their model error, so that less suffices there.
_FAR = 0.8
_FAR_SHARE = 0.1
#: Or, at some distance, it must leave so little of what the others leave, and of the change: two loads that were
#: taken for one between them. Two explain no single load that well, even one much larger than modelled.
_APART, _LEFT_OF_REST, _LEFT_OF_CHANGE = 0.4, 0.2, 0.05
#: Smallest size of a load that is found in that way, of the largest.
_COMPARABLE = 0.3
_MOST_LOADS = 4
_SWEEPS = 4
#: Places this close to the best one (in radii) are fitted for the vertex of the likelihood.
_NEIGHBOURHOOD = 0.13
_SEPARATE = 0.25
#: A weak load shows once the strong ones are taken out with all that their size and exact place may do: combinations
#: of so many patterns within this distance (value, slopes, curvatures) leave 0.1 % of a load on an even sheet.
_TAKEN_OUT, _TAKEN_PATTERNS = 0.2, 6
#: It must then stand out of the noise by this (noise alone reaches it at one of all places once in 10 000 changes)
#: and of what the model leaves of the strong ones, as shares of energy …
_WEAK_GAIN, _MODEL_LEAVES = 30.0, 2e-3
#: … and explain this share of what is left above noise: a sheet unlike the model leaves changes unlike any load.
_WEAK_EXPLAINED = 0.7
_ROBUST_ROUNDS = 8
_HUBER = 1.5
_HIDDEN = 0.2  #: a place whose pattern is nearer than this to those taken out cannot be looked at


@dataclass(frozen=True, slots=True)
class Place:
    """One load in a change.

    Parameters
    ----------
    x, y : place in units of the radius.
    index : index of the nearest candidate place.
    score : product of the unit pattern with the change; signed, + where the place conducts more.
    """

    x: float
    y: float
    index: int
    score: float


@dataclass(frozen=True, slots=True, eq=False)
class Matcher:
    """Whitened unit patterns with the nuisance projected out.

    Parameters
    ----------
    places : (p, 2) candidate places in units of the radius.
    sigma : (m,) noise of the readings.
    nuisance : (m,) unit vector, whitened.
    patterns : (m, p) float64, unit columns.
    """

    places: Array
    sigma: Array
    nuisance: Array
    patterns: Array

    def whiten(self, changes: Array) -> Array:
        """Divide by the noise and project the nuisance out: (n, m) → (n, m)."""
        white = changes / self.sigma
        return white - (white @ self.nuisance)[..., None] * self.nuisance


def matcher(patterns: Array, places: Array, sigma: Array, nuisance: Array) -> Matcher:
    """Prepare template matching for one noise level.

    Parameters
    ----------
    patterns : (m, p) unit changes. sigma : (m,) noise. nuisance : (m,) vector of any length, unwhitened.
    """
    hidden = nuisance / sigma
    hidden = hidden / np.linalg.norm(hidden)
    white = patterns / sigma[:, None]
    white = white - hidden[:, None] * (hidden @ white)
    return Matcher(places, sigma, hidden, white / np.linalg.norm(white, axis=0))


def find_places(
    change: Array, match: Matcher, *, noise: float = 1.0, most: int = _MOST_LOADS
) -> tuple[tuple[Place, ...], float]:
    """Find the loads that explain one change.

    Parameters
    ----------
    change : (m,) whitened.
    noise : variance of each reading of the change.
    most : largest number of loads to look for.

    Returns
    -------
    The loads, strongest first, and the share of the change's energy that they explain, 0 to 1.
    """
    total = float(change @ change)
    if total == 0:
        return (), 0.0
    place_indices = [_best(change, match, 0, ())]
    explained = _fit_power(change, match, place_indices)
    while len(place_indices) < most:
        further = _best(_fit_residual(change, match, place_indices), match, 0, tuple(place_indices))
        refined_indices = _optimise_places(change, match, [*place_indices, further], 0)
        gain = _fit_power(change, match, refined_indices) - explained
        needed = max(_FURTHER_SHARE * total, _FURTHER_OF_FIRST * explained)
        if _nearest(match, refined_indices) > _FAR:
            needed = _FAR_SHARE * total
        is_resolved = _resolves_loads(change, match, refined_indices, total - explained)
        if (gain < needed and not is_resolved) or _nearest(match, refined_indices) < _SEPARATE:
            break
        place_indices, explained = refined_indices, explained + gain
    places = _refine_places(change, match, place_indices)
    # With a single load, the remains of drift and of the sheet's own shape would be taken for another load.
    while 1 < len(places) < most and (weak := _find_weak_load(change, match, places, noise)):
        places.append(weak)
    explained = _fit_power(change, match, [place.index for place in places])
    return tuple(sorted(places, key=lambda place: -abs(place.score))), explained / total


def _resolves_loads(change: Array, match: Matcher, chosen: list[int], left_before: float) -> bool:
    """Whether places explain so much more than fewer did, which were unlike loads, that these were between them."""
    if left_before < (1 - LEAST_EXPLAINED) * float(change @ change):
        return False
    weights, *_ = np.linalg.lstsq(match.patterns[:, chosen], change, rcond=None)
    left = float(np.sum(_fit_residual(change, match, chosen) ** 2))
    alike = weights / weights[np.argmax(np.abs(weights))]
    return bool(
        left < min(_LEFT_OF_REST * left_before, _LEFT_OF_CHANGE * float(change @ change))
        and _nearest(match, chosen) >= _APART
        and alike.min() >= _COMPARABLE
    )


def _find_weak_load(change: Array, match: Matcher, places: list[Place], noise: float) -> Place | None:
    """Look again for a load of the same sign when stronger ones are taken out; None where none stands out."""
    strong_indices = [place.index for place in places]
    sign = np.sign(max(places, key=lambda place: abs(place.score)).score)
    basis = np.linalg.qr(np.hstack([_span_surroundings(match, index) for index in strong_indices]))[0]
    residual = change - basis @ (basis.T @ change)
    patterns = match.patterns - basis @ (basis.T @ match.patterns)
    norms = np.linalg.norm(patterns, axis=0)
    distances = np.hypot(*(match.places[:, None] - match.places[strong_indices]).T).min(axis=0)
    weak_match = Matcher(match.places, match.sigma, match.nuisance, patterns / np.maximum(norms, _HIDDEN))
    gain = np.where(
        (distances >= _SEPARATE) & (norms > _HIDDEN), np.maximum(sign * residual @ weak_match.patterns, 0.0) ** 2, 0.0
    )
    best_index = int(np.argmax(gain))
    energy_above_noise = float(residual @ residual) - noise * (len(residual) - basis.shape[1])
    needed = max(_WEAK_GAIN * noise + _MODEL_LEAVES * float(change @ change), _WEAK_EXPLAINED * energy_above_noise)
    if gain[best_index] < needed:
        return None
    place = _refine_place(residual, weak_match, best_index)
    return replace(place, score=place.score / float(norms[best_index]))


def _span_surroundings(match: Matcher, index: int) -> Array:
    """Unit combinations (m, 6) of the patterns about a place that hold most of them."""
    near = np.hypot(*(match.places - match.places[index]).T) <= _TAKEN_OUT
    return np.linalg.svd(match.patterns[:, near], full_matrices=False)[0][:, :_TAKEN_PATTERNS]


def fit_loads(change: Array, match: Matcher, places: tuple[Place, ...]) -> Array:
    """Return the least-squares fit (m,) of loads at these places to a change."""
    return change - _fit_residual(change, match, [place.index for place in places])


def robust_directions(places: tuple[Place, ...], change: Array, match: Matcher) -> tuple[Place, ...]:
    """Turn places towards a robust fit, keeping their distance from the centre.

    Iteratively reweighted least squares with Huber's weights: a corroded or misplaced electrode does not decide the
    direction.

    Parameters
    ----------
    places : found from each channel's change relative to its own reference value, which weights far readings
        correctly for the distance, but also their faults.
    change : (m,) change in one scale for all channels, unwhitened. match : matcher prepared for it with equal noise.
    """
    sigma = np.ones_like(change)
    place_indices = [place.index for place in places]
    signs = {place.index: place.score for place in places}
    sign = int(np.sign(places[0].score)) if len({s > 0 for s in signs.values()}) == 1 else 0
    reweighted = match
    for _ in range(_ROBUST_ROUNDS):
        white_change = reweighted.whiten(change[None])[0]
        place_indices = _optimise_places(white_change, reweighted, place_indices, sign)
        residual = np.abs(_fit_residual(white_change, reweighted, place_indices) * sigma)
        spread = max(MAD_TO_SIGMA * float(np.median(residual)), 1e-300)
        sigma = np.sqrt(np.maximum(residual / (_HUBER * spread), 1.0))
        reweighted = matcher(match.patterns, match.places, sigma, match.nuisance)
    white_change = reweighted.whiten(change[None])[0]
    refined = _refine_places(white_change, reweighted, place_indices)
    return tuple(_correct_direction(place, refined) for place in places)


def _correct_direction(place: Place, seen: list[Place]) -> Place:
    nearest = min(seen, key=lambda other: float(np.hypot(other.x - place.x, other.y - place.y)))
    distance = float(np.hypot(nearest.x, nearest.y))
    radius = float(np.hypot(place.x, place.y))
    # Near the centre there is no direction to correct, and a fit that moved far is not about this place.
    if radius < _SEPARATE or np.hypot(nearest.x - place.x, nearest.y - place.y) > _SEPARATE:
        return place
    return replace(place, x=nearest.x / distance * radius, y=nearest.y / distance * radius)


def _best(change: Array, match: Matcher, sign: int, besides: tuple[int, ...]) -> int:
    scores = change @ match.patterns
    scores = np.abs(scores) if sign == 0 else sign * scores
    for taken_index in besides:
        near = np.hypot(*(match.places - match.places[taken_index]).T) < _SEPARATE
        scores = np.where(near, -np.inf, scores)
    return int(np.argmax(scores))


def _fit_residual(change: Array, match: Matcher, chosen: list[int]) -> Array:
    if not chosen:
        return change
    basis = match.patterns[:, chosen]
    weights = np.linalg.lstsq(basis, change, rcond=None)[0]
    return change - basis @ weights


def _fit_power(change: Array, match: Matcher, chosen: list[int]) -> float:
    residual = _fit_residual(change, match, chosen)
    return float(change @ change - residual @ residual)


def _optimise_places(change: Array, match: Matcher, chosen: list[int], sign: int) -> list[int]:
    for _ in range(_SWEEPS):
        previous = list(chosen)
        for k in range(len(chosen)):
            other_indices = chosen[:k] + chosen[k + 1 :]
            chosen[k] = _best(_fit_residual(change, match, other_indices), match, sign, tuple(other_indices))
        if chosen == previous:
            break
    return chosen


def _nearest(match: Matcher, chosen: list[int]) -> float:
    places = match.places[chosen]
    distances = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1)) + 9 * np.eye(len(chosen))
    return float(distances.min())


def _refine_places(change: Array, match: Matcher, chosen: list[int]) -> list[Place]:
    """Refine each place in what the others leave."""
    return [
        _refine_place(_fit_residual(change, match, chosen[:k] + chosen[k + 1 :]), match, best)
        for k, best in enumerate(chosen)
    ]


def _refine_place(left: Array, match: Matcher, best: int) -> Place:
    """Move to the vertex of the likelihood between the candidate places, by a quadratic through the neighbours.

    ``left`` : (m,) of the change, without the other loads.
    """
    scores = left @ match.patterns
    centre = match.places[best]
    offset = match.places - centre
    near_mask = np.hypot(*offset.T) <= _NEIGHBOURHOOD
    x, y = offset[near_mask].T
    shift = np.zeros(2)
    if near_mask.sum() >= 8:
        design = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
        _, b, c, d, e, f = np.linalg.lstsq(design, np.abs(scores[near_mask]), rcond=None)[0]
        hessian = np.array([[2 * d, e], [e, 2 * f]])
        if np.all(np.linalg.eigvalsh(hessian) < 0):
            shift = np.linalg.solve(hessian, [-b, -c])
    if np.hypot(*shift) > _NEIGHBOURHOOD:
        shift = np.zeros(2)
    place = centre + shift
    return Place(float(place[0]), float(place[1]), best, float(scores[best]))
