"""Readings as features, the pattern's symmetry, and the covariance behind both estimates."""

from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.results.learned_place import FeatureScaling, PatternTurns
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout

#: Features that spikes turn against their template are replaced by this share of it.
LEAST_LIKENESS: Final = 0.05
#: A frame that lost more of its readings lost more than spikes: its size is brought to that of all readings.
_MORE_THAN_SPIKES: Final = 0.05
#: A reading's ceiling, in 90 % quantiles of its size; and what is taken for a spike, in ceilings: one reading of a
#: thousand on two real skins, and with adjacent pairs of a simulated one whose presses reach the electrodes.
_CEILING, _SPIKE = 3.0, 3.5
#: Share of spikes from which presses are spiky: those beside electrodes have a tenth of that. Quantiles of 90 % may
#: then be spikes themselves. Those of 80 % are not, and are two thirds of them on sheets without spikes.
SPIKY: Final = 0.01
_SAFE, _SAFE_CEILING = 0.8, 4.5


def safe_ceilings(changes: Array) -> Array:
    """Ceilings (m,) of :func:`ceilings_of` that stay sound if up to a fifth of the presses are faulty."""
    return _ceilings(changes, _SAFE, _SAFE_CEILING)


def ceilings_of(changes: Array) -> Array:
    """Ceilings (m,) of readings from presses (n, m); zero for those that are zero in all."""
    return _ceilings(changes, 0.9, _CEILING)


def _ceilings(changes: Array, level: float, times: float) -> Array:
    sizes = np.quantile(np.abs(changes), level, axis=0)
    return times * np.where(sizes > 0, sizes, np.abs(changes).max(axis=0))


def spikes_among(changes: Array) -> Mask:
    """Mask (n, m) of readings of presses that are spikes, judged by the other presses."""
    spikes = spikes_in(changes, ceilings_of(changes))
    if spikes.mean() > SPIKY:
        spikes |= spikes_in(changes, safe_ceilings(changes))
        spikes |= spikes_in(changes, ceilings_of(np.where(spikes, 0.0, changes)))
    return spikes


def spikes_in(changes: Array, ceiling: Array) -> Mask:
    """Mask (n, m) of readings that are spikes: far larger than in other presses, and than most of the same press."""
    sizes = np.abs(changes) / np.where(ceiling > 0, ceiling, np.inf)
    return sizes > _SPIKE * np.maximum(np.quantile(sizes, 0.9, axis=1, keepdims=True), 1.0)


def features_of(readings: Array, scaling: FeatureScaling) -> Array:
    """Turn readings (n, m) into features (n, m).

    The exponent brings large readings closer to small ones, whose relative errors are alike; the damping takes out a
    part of a frame's size, which varies with force and drifts; the ceiling takes the weight off spikes.
    """
    roots = _roots(readings, scaling)
    size = np.linalg.norm(roots, axis=1, keepdims=True)
    return roots / np.where(size > 0, size, 1.0) ** scaling.damping


def predict_features(expected: Array, readings: Array, scaling: FeatureScaling) -> Array:
    """Turn changes (n, m) that are expected in any unit into features of presses with readings (n, m).

    Readings of zero do not count: they may be those that are not known.
    """
    uncut = replace(scaling, ceiling=np.full_like(scaling.ceiling, np.inf))
    expected_roots, roots = np.where(readings == 0, 0.0, _roots(expected, uncut)), _roots(readings, uncut)
    power = np.maximum((expected_roots**2).sum(axis=1), np.finfo(float).tiny)
    factor = np.maximum((expected_roots * roots).sum(axis=1) / power, 0.0) ** (1 / scaling.exponent)
    return features_of(factor[:, None] * expected, scaling)


def strengths(readings: Array, likeness: Array, scaling: FeatureScaling) -> Array:
    """Strengths (n,) of readings (n, m): proportional to them, about one if they equal their template.

    Parameters
    ----------
    likeness : (n,) likeness of their features to the template, by least squares.
    """
    size = np.linalg.norm(_roots(readings, scaling), axis=1)
    strength: Array = (np.maximum(likeness, LEAST_LIKENESS) * size**scaling.damping) ** (1 / scaling.exponent)
    return strength


def more_than_spikes(lost: Mask, used: Mask) -> Mask:
    """Mask (n,) of frames that lost so many of the used readings (m,) that sizes tell less; ``lost`` is (n, m)."""
    return np.asarray(lost[:, used].mean(axis=1) > _MORE_THAN_SPIKES)


def size_factors(known: Array, whole: Array, scaling: FeatureScaling) -> Array:
    """Factors (n,) by which features (n, m) with lost readings filled in are too large: sizes are of the known ones.

    One where nothing is known, or nothing changes.

    Parameters
    ----------
    known, whole : (n, m) the features before, zero where they are lost, and after.
    """
    size_before, size_after = (np.linalg.norm(features, axis=1) for features in (known, whole))
    sized_mask = (size_before > 0) & (size_after > 0)
    return (np.where(sized_mask, size_before, 1.0) / np.where(sized_mask, size_after, 1.0)) ** scaling.damping


def _roots(readings: Array, scaling: FeatureScaling) -> Array:
    return np.sign(readings) * np.minimum(np.abs(readings), scaling.ceiling) ** scaling.exponent


def pattern_turns(pairs: Indices, electrodes: int) -> PatternTurns:
    """Find the rotations and mirrors of a ring of electrodes that leave a pattern unchanged.

    Parameters
    ----------
    pairs : (m, 4) source, sink, plus, minus, electrodes from 0; no reading twice.
    electrodes : N, evenly spaced around the sheet.

    Returns
    -------
    Its symmetries, the identity first.
    """
    index_by_pair = {tuple(pair): number for number, pair in enumerate(pairs.tolist())}
    symmetries = [
        (*mapping, turn_by(2 * np.pi * step / electrodes, mirrored=mirror < 0))
        for mirror in (1, -1)
        for step in range(electrodes)
        if (mapping := _find_readings((mirror * pairs + step) % electrodes, index_by_pair)) is not None
    ]
    permuted, signs, turns = (np.array(part) for part in zip(*symmetries, strict=True))
    return PatternTurns(permuted.astype(np.int64), signs.astype(np.float64), turns)


def _find_readings(pairs: Indices, where: dict[tuple[int, ...], int]) -> tuple[list[int], list[int]] | None:
    """Indices and signs of readings in a pattern, or None if one is missing. Either polarity is the same reading."""
    numbers, signs = [], []
    for a, b, c, d in pairs.tolist():
        same_polarity = [where[key] for key in ((a, b, c, d), (b, a, d, c)) if key in where]
        reversed_polarity = [where[key] for key in ((b, a, c, d), (a, b, d, c)) if key in where]
        if not same_polarity + reversed_polarity:
            return None
        numbers.append((same_polarity + reversed_polarity)[0])
        signs.append(1 if same_polarity else -1)
    return (numbers, signs) if len(set(numbers)) == len(numbers) else None


def turn_by(angle: float, *, mirrored: bool) -> Array:
    """Matrix (2, 2) of a turn by an angle [rad], of the mirrored plane where ``mirrored``."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn * [1, -1] if mirrored else turn


def ring_axes(layout: ElectrodeLayout) -> Array:
    """Axes (2, 2) of a ring in those of its sheet, as of ``LearnedPlace``."""
    first, second = layout.angles_rad()[:2]
    axes = np.array([[np.cos(first), np.sin(first)], [-np.sin(first), np.cos(first)]])
    axes[1] *= np.sign(second - first)
    return axes


def compute_squared_distances(a: Array, b: Array) -> Array:
    """Squared Euclidean distances (n, k) of rows (n, m) and (k, m); rounding errors below zero are cut."""
    squares: Array = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.maximum(squares, 0.0)


def matern(squared: Array) -> Array:
    """Matérn correlation of smoothness 5/2 at squared distances in lengths (Rasmussen & Williams 2006, Eq. 4.17)."""
    return matern_and_slope(squared)[0]


def matern_and_slope(squared: Array) -> tuple[Array, Array]:
    """Return :func:`matern` and its derivative by the squared distance."""
    root = np.sqrt(5 * squared)
    fall = np.exp(-root)
    slope = (1 + root) * fall
    correlation: Array = slope + root**2 / 3 * fall
    slope *= -5 / 6
    return correlation, slope
