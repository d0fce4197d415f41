"""Drift of readings over presses: presses are brought to the last of them, and readings may drift further.

An offset and a gain of every reading walk at random. Both are fitted to the differences of presses from the templates
of all others, as the first functions of the Karhunen–Loève series of a random walk (Wiener process), with the
variances of largest marginal likelihood. So a few presses made much later, a re-check, tell where the readings have
gone. Presses in random order show no drift, and get none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices

#: Number of sessions after the last press for which a calibration is stated; after a re-check it is one.
SESSIONS: Final = 5.0
_FUNCTIONS: Final = 6  # they hold 97 % of the variance of a walk
#: Candidate variances of a walk over all presses, in variances of a reading's errors.
_WALKS: Final = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
#: Variance of the offset and gain that all presses have in common.
_COMMON: Final = 1.0
_SHUFFLES: Final = 49
_SEED: Final = [int.from_bytes(b"drift"), 0]
#: Fewest presses of a re-check, their largest share of all, and the least ratio of the presses before to them.
_FEWEST_LATE: Final = 3
_LATE_SHARE: Final = 0.1
_BEFORE: Final = 3


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Changes of the features (n, m) of presses.

    Parameters
    ----------
    since : (n, m) change by drift between each press and the last one. A press of a re-check is brought to where the
        others of the re-check tell the readings are, so that it can tell how far that is right.
    later : standard deviation of the change that later drift may add, in all features together.
    late : number of presses at the end that are a re-check.
    horizon : sessions after the last press that a calibration is stated for.
    variances : (2,) variances added to the offset and to the gain until then, in mean squares of errors and, of the
        gain, of expected features over their root mean square.
    """

    since: Array
    later: Array
    late: int
    horizon: float
    variances: Array


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """Times at which presses were made.

    Parameters
    ----------
    time : (n,) times in lengths of the session.
    late : number of presses at the end that are a re-check.
    """

    time: Array
    late: int

    @property
    def horizon(self) -> float:
        """Sessions after the last press that a calibration is stated for."""
        return 1.0 if self.late else SESSIONS

    def select(self, presses: Indices) -> "Session":
        """Session of some presses, in rising order."""
        recheck_count = int(np.count_nonzero(presses >= len(self.time) - self.late))
        return Session(self.time[presses], recheck_count)


def session_of(errors: Array, time_s: Array | None) -> Session:
    """Find when presses were made, and which are a re-check.

    Parameters
    ----------
    errors : (n, m) errors of presses that were left out: seen less expected features.
    time_s : (n,) times of the presses, rising; None where they were made one after the other, a re-check at the end
        apart.
    """
    return Session(*_sessions(_scale_to_unit_rms(errors)[0], time_s, _orders(len(errors))))


def find_drift(errors: Array, expected: Array, session: Session, *, certain: bool = False) -> Drift | None:
    """Fit the drift of features; None where presses in random order would show as much in one case of fifty.

    Parameters
    ----------
    errors, expected : (n, m) seen less expected features of presses that were left out, and expected features.
    certain : True if the presses are known to drift, by others of their features.
    """
    scaled, deviation = _scale_to_unit_rms(errors)
    relative, _ = _scale_to_unit_rms(expected)
    walk, recheck_count = _Walk.from_times(session.time), session.late
    if not certain and walk.score(scaled, relative) <= max(
        replace(walk, at=walk.at[order]).score(scaled, relative) for order in _orders(len(errors))
    ):
        return None
    variances, expected_variances = walk.likely(scaled, relative)
    coefficients = walk.fit(scaled, relative, variances)
    since = _evaluate_drift(walk.at[-1] - walk.at, coefficients, relative)
    for press in range(len(scaled) - recheck_count, len(scaled)):
        other_presses = np.delete(np.arange(len(scaled)), press)
        coefficient_change = (
            replace(walk, at=walk.at[other_presses]).fit(scaled[other_presses], relative[other_presses], variances)
            - coefficients
        )
        since[press] -= _evaluate_drift(
            walk.at[[press]] - walk.at[: len(scaled) - recheck_count].mean(axis=0),
            coefficient_change,
            relative[[press]],
        )[0]
    horizon_drift = _evaluate_drift((walk.at[-1] - walk.at[0])[None], coefficients, relative)
    sessions = session.horizon / float(np.ptp(session.time))
    return Drift(
        deviation * since,
        deviation * np.sqrt(sessions) * horizon_drift,
        recheck_count,
        session.horizon,
        sessions * expected_variances,
    )


def _scale_to_unit_rms(values: Array) -> tuple[Array, Array]:
    """Values (n, m) over their root mean squares (m,), and these; one where all are zero."""
    deviation = np.sqrt((values**2).mean(axis=0))
    return values / np.where(deviation > 0, deviation, 1.0), deviation


def _orders(count: int) -> list[Indices]:
    """Random orders of presses that a drift must exceed."""
    random = np.random.default_rng(_SEED)
    return [random.permutation(count) for _ in range(_SHUFFLES)]


def _evaluate_drift(functions: Array, coefficients: Array, relative: Array) -> Array:
    """Drift (n, m) of relative features (n, m) by the walk's functions (n, k) and coefficients (2, k, m)."""
    offset, gain = functions @ coefficients
    added: Array = offset + relative * gain
    return added


@dataclass(frozen=True, slots=True, eq=False)
class _Walk:
    """A random walk at the times of presses: functions (n, k) of its series, and their variances (k,)."""

    at: Array
    variances: Array

    @classmethod
    def from_times(cls, time: Array) -> "_Walk":
        """The walk over times (n,), of variance one at the last."""
        frequency = np.pi * (np.arange(_FUNCTIONS) + 0.5)
        scaled = (time - time.min()) / max(float(np.ptp(time)), np.finfo(float).tiny)
        functions: Array = 2**0.5 * np.sin(scaled[:, None] * frequency)
        return cls(functions, 1 / frequency**2)

    def score(self, scaled: Array, relative: Array) -> float:
        """Slope of the likelihood of errors (n, m) with the variance of a walk of offset and gain, at zero."""
        centred = self.at - self.at.mean(axis=0)
        projections = (centred.T @ scaled) ** 2 + (centred.T @ (scaled * relative)) ** 2
        return float((self.variances @ projections).sum())

    def likely(self, scaled: Array, relative: Array) -> tuple[tuple[float, float], Array]:
        """Variances of offset and gain with the largest marginal likelihood, in variances of noise.

        The second result is their mean (2,) over all candidates, in squared errors, whose mean over features is one.
        """
        problem = self._problem(scaled, relative)
        candidates = [(offset, gain) for offset in _WALKS for gain in _WALKS]
        solutions = [self._solve(problem, variances) for variances in candidates]
        likelihoods, noise = np.array([(likelihood, noise.mean()) for likelihood, _, noise in solutions]).T
        weights = np.exp((likelihoods - likelihoods.max()) / 2)
        means: Array = (weights / weights.sum() * noise) @ np.array(candidates)
        return candidates[int(likelihoods.argmax())], means

    def fit(self, scaled: Array, relative: Array, variances: tuple[float, float]) -> Array:
        """Coefficients (2, k, m) of offset and gain."""
        means = self._solve(self._problem(scaled, relative), variances)[1]
        return means.T.reshape(2, len(self.variances) + 1, -1)[:, 1:]

    def _problem(self, scaled: Array, relative: Array) -> tuple[Array, Array, Array]:
        """Normal equations of every reading: (m, 2 k + 2, 2 k + 2) and (m, 2 k + 2), and the squared errors (m,)."""
        count = len(scaled)
        basis = np.column_stack([np.ones(count), self.at])
        products = (basis[:, :, None] * basis[:, None, :]).reshape(count, -1)
        offset_moments, mixed_moments, gain_moments = (
            (products.T @ relative**power).T.reshape(-1, *[basis.shape[1]] * 2) for power in range(3)
        )
        gram = np.concatenate(
            [
                np.concatenate([offset_moments, mixed_moments], axis=2),
                np.concatenate([mixed_moments, gain_moments], axis=2),
            ],
            axis=1,
        )
        projections = np.concatenate([basis.T @ scaled, basis.T @ (scaled * relative)]).T
        return gram, projections, (scaled**2).sum(axis=0)

    def _solve(
        self, problem: tuple[Array, Array, Array], variances: tuple[float, float]
    ) -> tuple[float, Array, Array]:
        """Twice the logarithm of the likelihood, means (m, 2 k + 2), and each reading's variance of noise (m,)."""
        gram, projections, total = problem
        root = np.sqrt(np.concatenate([[_COMMON, *(each * self.variances)] for each in variances]))
        precision = np.eye(len(root)) + gram * np.outer(root, root)
        means = root * np.linalg.solve(precision, (root * projections)[:, :, None])[:, :, 0]
        residual_squares = np.maximum(total - (projections * means).sum(axis=1), np.finfo(float).tiny)
        likelihood = -len(self.at) * np.log(residual_squares).sum() - np.linalg.slogdet(precision)[1].sum()
        return float(likelihood), means, residual_squares / len(self.at)


def _sessions(scaled: Array, time_s: Array | None, orders: Sequence[Indices]) -> tuple[Array, int]:
    """Times (n,) of presses in sessions, and how many of them at the end are a re-check.

    A re-check follows the longest break, if that is longer than the session before it. Without times it is seen by
    its jump, and taken to be as late as a calibration is stated for.
    """
    count = len(scaled)
    if time_s is None:
        recheck_count = _late(scaled, orders)
        time = np.linspace(0.0, 1.0, count - recheck_count)
        return np.append(time, 1 + SESSIONS + np.arange(recheck_count) / count), recheck_count
    breaks = np.diff(time_s)
    last_before_break = int(breaks.argmax())
    session = float(time_s[last_before_break] - time_s[0])
    if 0 < session < breaks[last_before_break]:
        return (time_s - time_s[0]) / session, count - last_before_break - 1
    return (time_s - time_s[0]) / max(float(np.ptp(time_s)), np.finfo(float).tiny), 0


def _late(scaled: Array, orders: Sequence[Indices]) -> int:
    """Number of presses at the end that are a re-check: they jump more than in random orders, and than any before."""
    count = len(scaled)
    largest_count = max(int(_LATE_SHARE * count), _FEWEST_LATE)
    fewest = (1 + _BEFORE) * largest_count
    if fewest > count - largest_count:
        return 0
    jumps = _jumps(scaled, largest_count)
    ends = np.unique(np.linspace(fewest, count - largest_count, _SHUFFLES).astype(np.int64))
    references = chain((scaled[order] for order in orders), (scaled[:end] for end in ends))  # one at a time
    if jumps.max() <= max(_jumps(reference, largest_count).max() for reference in references):
        return 0
    return _FEWEST_LATE + int(jumps.argmax())


def _jumps(scaled: Array, most: int) -> Array:
    """Squared jumps of the errors' mean before the last presses, in squared standard errors, by their number.

    The smallest of those without one of the last presses: a single odd press is no jump.
    """
    rows = scaled[::-1]
    sums = np.cumsum(rows, axis=0)
    jumps = np.empty(most + 1 - _FEWEST_LATE)
    for number, count in enumerate(range(_FEWEST_LATE, most + 1)):
        last = (sums[count - 1] - rows[:count]) / (count - 1)
        mean_before = (sums[(1 + _BEFORE) * count - 1] - sums[count - 1]) / (_BEFORE * count)
        jumps[number] = ((last - mean_before) ** 2).mean(axis=1).min() / (1 / (count - 1) + 1 / (_BEFORE * count))
    return jumps
