"""Sessions: whether groups differ from each other in the same way on every station.

    y = group (fixed) + station (fixed) + session (random, σ²ρ) + sensor (random, σ²θ) + run (σ²)

A session is a group at a station. With U (N × c) the sessions of the runs, H = V/σ² without sessions and X = UC the
columns of groups and stations, the means of sessions β = A⁻¹UᵀH⁻¹y, A = UᵀH⁻¹U, are sufficient, and

    β = Cγ + error,   cov(error) = σ²(A⁻¹ + ρI).

**Lack of fit.** F = S/(d σ̂²) with S = (β − Cγ)ᵀA(β − Cγ), d = c − p, and σ̂² from runs within sessions. Sessions
raise it to 1 + ρk, k = tr(A − AC(CᵀAC)⁻¹CᵀA)/d. Two batches on three stations leave d = 2, which seldom shows
anything. But what disturbs a session disturbs most metrics, so all metrics of a comparison are tested together,
with the degrees of freedom of as many independent metrics as their correlations leave.

**If it is shown**, each metric's F is moderated (Smyth 2004): the scatter of log F over metrics beyond what F alone
gives tells how much their ratios differ, and d₀ degrees of freedom of a common ratio are added to the d of each. A
metric whose own F alone shows lack of fit keeps its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf, log, sqrt

import numpy as np
from scipy import linalg, optimize, sparse, special, stats

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.crossings import Crossing, SparseArray
from cbsr_qa.stats.mixed_model.model import ContrastFreedom, Fit, Model, Scatter
from cbsr_qa.stats.mixed_model.reml import random_effect_sums, small_sample, variance_ratio
from cbsr_qa.stats.mixed_model.scatter import scatter_products
from cbsr_qa.stats.samples import LEAST_SPREAD

#: Level of the test of lack of fit.
LEVEL = 0.05
#: Smallest F that counts: its logarithm must exist.
_MIN_F = 1e-8
#: An F has a mean if its denominator has more degrees of freedom than this.
_MIN_FREEDOM_OF_MEAN = 2.0
#: Degrees of freedom that stand for infinitely many.
_MAX_FREEDOM = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class SessionMeans:
    """Means of the sessions of one metric.

    Parameters
    ----------
    means : (c,) β of the residuals of the additive fit, in the metric's unit.
    covariance : (c, c) of the means without sessions, A⁻¹, over σ²; Kenward and Roger's where sensors are random.
    variance : σ̂², from runs within sessions.
    small : basis of the degrees of freedom; None where every contrast has ``run_freedom``.
    run_freedom : runs minus sessions; where groups scatter differently, sensors minus sessions.
    sensors, residuals : (q,) names, and means of a sensor's residuals within sessions over their root mean square.
    columns : (c, p) C: the columns of groups and stations, one row per session.
    """

    means: Array
    covariance: Array
    variance: float
    small: ContrastFreedom | None
    run_freedom: float
    sensors: tuple[str, ...]
    residuals: Array = field(default_factory=lambda: np.zeros(0))
    columns: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def freedom(self, contrast: Array) -> float:
        """Return the degrees of freedom of the variance of a contrast of means (c,)."""
        return self.run_freedom if self.small is None else self.small.freedom(contrast)

    def departure(self) -> "Departure":
        """Return how far the means are from the additive model."""
        contrasts = linalg.null_space(self.columns.T)
        variances, axes = np.linalg.eigh(contrasts.T @ self.covariance @ contrasts)
        directions = contrasts @ axes
        statistic = float(np.mean((directions.T @ self.means) ** 2 / variances)) / self.variance
        freedoms = np.array([self.freedom(direction) for direction in directions.T])
        return Departure(
            statistic=statistic,
            freedom=len(variances),
            run_freedom=_combine_freedoms(freedoms),
            gain=float(np.mean(1 / variances)),
        )


@dataclass(frozen=True, slots=True)
class Departure:
    """F of the departure of sessions from the additive model.

    Parameters
    ----------
    freedom, run_freedom : degrees of freedom d of the numerator, and of the denominator.
    gain : k, the rise of F with ρ.
    """

    statistic: float
    freedom: int
    run_freedom: float
    gain: float


def _combine_freedoms(freedoms: Array) -> float:
    """Return the degrees of freedom of the denominator of an F of independent contrasts (Fai & Cornelius 1996).

    Parameters
    ----------
    freedoms : (d,) of each contrast's variance.
    """
    least = float(freedoms.min())
    if least <= _MIN_FREEDOM_OF_MEAN or float(np.ptp(freedoms)) <= 1e-9 * least:
        return least
    expected = float(np.sum(freedoms / (freedoms - 2)))
    return 2 * expected / (expected - len(freedoms))


@dataclass(frozen=True, slots=True)
class SessionRatio:
    """1 + ρk of one metric and its degrees of freedom."""

    value: float
    freedom: float


@dataclass(frozen=True, slots=True, eq=False)
class SessionVariance:
    """Basis of the degrees of freedom of contrasts where sessions are random; see :func:`add_sessions`.

    Parameters
    ----------
    covariance : (p, p) Φ/σ².
    slope : (p, p) derivative of the covariance by ρ, over σ².
    share : ρ + 1/k, by which relative errors of the session ratio act.
    reach : (p, c) effects by the means of sessions.
    means : means of the sessions, and basis of the degrees of freedom of σ².
    session_freedom : degrees of freedom of 1 + ρk.
    scatter : basis of those of σ² where groups scatter differently; else None.
    """

    covariance: Array
    slope: Array
    share: float
    reach: Array
    means: SessionMeans
    session_freedom: float
    scatter: ContrastFreedom | None

    def freedom(self, contrast: Array) -> float:
        """Return Satterthwaite's degrees of freedom of one contrast (p,)."""
        run_freedom = min(
            self.means.freedom(contrast @ self.reach), self.scatter.freedom(contrast) if self.scatter else inf
        )
        part = float(contrast @ self.slope @ contrast) * self.share / float(contrast @ self.covariance @ contrast)
        return 1 / (1 / run_freedom + part**2 / self.session_freedom)


def fit_session_means(additive: Fit, values: Array) -> SessionMeans | None:
    """Fit the means of sessions.

    None if the additive model has as many parameters as there are sessions, so that no departure from it can show, or
    if too few sensors differ within sessions.

    Parameters
    ----------
    values : (N,) of the runs of ``additive.design``.
    """
    design = additive.design
    keys = design.group * len(design.stations) + design.station
    _, first_runs, session = np.unique(keys, return_index=True, return_inverse=True)
    columns = np.asarray(design.columns()[first_runs.astype(np.intp)].toarray(), dtype=np.float64)
    if len(first_runs) == columns.shape[1] or len(design.sensors) <= len(first_runs):
        return None
    residuals = values - design.columns() @ additive.effects[design.independent_columns()]
    scale = float(np.abs(residuals).max())
    members = sparse.coo_array((np.ones(len(session)), (np.arange(len(session)), session))).tocsr()
    if additive.scatter is None:
        estimated = _estimate_means(additive, members, residuals / scale)
    else:
        estimated = _estimate_scattered_means(additive.scatter.scale(1 / scale), design, members, residuals / scale)
    if estimated is None:
        return None
    within = (residuals - (np.bincount(session, residuals) / np.bincount(session))[session]) / scale
    if additive.scatter is not None:
        deviations = np.hypot(additive.scatter.run_deviation, additive.scatter.sensor_deviations)
        within /= (deviations / deviations.max())[design.group]
    of_sensors = np.bincount(design.sensor, within) / np.bincount(design.sensor)
    size = sqrt(float(np.mean(of_sensors**2)))
    return replace(
        estimated,
        columns=columns,
        means=scale * estimated.means,
        variance=scale**2 * estimated.variance,
        residuals=of_sensors / size if size > LEAST_SPREAD else np.zeros_like(of_sensors),
    )


def _estimate_means(additive: Fit, members: SparseArray, response: Array) -> SessionMeans | None:
    """Return the means of a response (N,) by restricted likelihood, if sensors scatter alike in all groups."""
    design, is_mixed = additive.design, additive.model is Model.MIXED
    sums = random_effect_sums(members, response, design.sensor)
    try:
        ratio = variance_ratio(sums).value if is_mixed else 0.0
    except NumericsError:
        return None
    products = sums.within + sums.products(ratio)
    means = np.asarray(np.linalg.solve(products[:-1, :-1], products[:-1, -1]), dtype=np.float64)
    variance = float(products[-1, -1] - products[:-1, -1] @ means) / (sums.runs - sums.columns)
    if variance <= LEAST_SPREAD**2:
        return None
    small = small_sample(sums, ratio) if is_mixed else None
    covariance = np.asarray(np.linalg.inv(products[:-1, :-1]), dtype=np.float64) if small is None else small.adjusted
    return SessionMeans(means, covariance, variance, small, float(sums.runs - sums.columns), design.sensors)


def _estimate_scattered_means(
    scatter: Scatter, design: Crossing, members: SparseArray, response: Array
) -> SessionMeans:
    """Return the means of a response (N,) where each group has its own scatter; their covariance counts σ² as 1."""
    products = scatter_products(design, members, response, scatter).sum(axis=0)
    covariance = np.asarray(np.linalg.inv(products[:-1, :-1]), dtype=np.float64)
    freedom = float(len(design.sensors) - members.shape[1])
    return SessionMeans(covariance @ products[:-1, -1], covariance, 1.0, None, freedom, design.sensors)


@dataclass(frozen=True, slots=True)
class LackOfFit:
    """Test of the additive model by all metrics together.

    Parameters
    ----------
    p_value : probability of departures as large if sessions have no effect: of all metrics together, or of one alone
        (Bonferroni).
    ratios : 1 + ρk of each metric, in their order; empty where lack of fit is not shown.
    """

    p_value: float
    ratios: tuple[SessionRatio, ...]

    @property
    def shown(self) -> bool:
        """Whether sessions have to be in the model."""
        return self.p_value < LEVEL


def lack_of_fit(found: Sequence[Departure], correlations: Array) -> LackOfFit:
    """Test the additive model on all metrics, and moderate the ratios of sessions.

    Parameters
    ----------
    found : departures of at least one metric.
    correlations : (K, K) of the metrics' values within sessions.
    """
    departures = np.maximum([departure.statistic for departure in found], _MIN_F)
    freedoms = np.array([departure.freedom for departure in found], dtype=float)
    error_freedoms = np.array([departure.run_freedom for departure in found])
    own_p_values = np.asarray(stats.f.sf(departures, freedoms, error_freedoms), dtype=np.float64)
    independent = len(found) ** 2 / float(np.sum(correlations**2))
    joint_departure = float(freedoms @ departures / freedoms.sum())
    joint_freedom = independent * float(freedoms.mean())
    joint_p_value = float(stats.f.sf(joint_departure, joint_freedom, independent * float(error_freedoms.mean())))
    p_value = min(1.0, 2 * min(joint_p_value, len(found) * float(own_p_values.min())))
    if p_value >= LEVEL:
        return LackOfFit(p_value, ())
    common_ratio, common_freedom = _estimate_common_ratio(departures, freedoms, error_freedoms)
    moderated = (common_freedom * common_ratio + freedoms * departures) / (common_freedom + freedoms)
    moderated_freedoms = np.minimum(common_freedom + freedoms, joint_freedom)
    keeps_own = len(found) * own_p_values < LEVEL
    keeps_own &= departures > moderated
    ratios = np.where(keeps_own, departures, moderated)
    ratio_freedoms = np.where(keeps_own, freedoms, moderated_freedoms)
    return LackOfFit(
        p_value,
        tuple(
            SessionRatio(max(float(ratio), 1.0), float(freedom))
            for ratio, freedom in zip(ratios, ratio_freedoms, strict=True)
        ),
    )


def correlate(metrics: Sequence[SessionMeans]) -> Array:
    """Return the correlations (K, K) of metrics over sensors within sessions; a missing value counts as zero."""
    names = dict.fromkeys(name for metric in metrics for name in metric.sensors)
    places = {name: index for index, name in enumerate(names)}
    residuals = np.zeros((len(metrics), len(places)))
    for row, metric in zip(residuals, metrics, strict=True):
        row[[places[name] for name in metric.sensors]] = metric.residuals
    products = residuals @ residuals.T
    scales = np.sqrt(np.diagonal(products))
    scales[scales == 0] = 1.0  # residuals of a sensor's runs may cancel: such a metric counts as independent
    correlations: Array = products / np.multiply.outer(scales, scales)
    np.fill_diagonal(correlations, 1.0)
    return correlations


def _estimate_common_ratio(departures: Array, freedoms: Array, error_freedoms: Array) -> tuple[float, float]:
    """Return the common ratio of the metrics and its degrees of freedom d₀ (Smyth 2004, section 6.2)."""
    if len(departures) < 2:
        return 1.0, 0.0
    logs = np.log(departures) - _expect_log(freedoms) + _expect_log(error_freedoms)
    excess = float(np.var(logs, ddof=1)) - float(
        np.mean(special.polygamma(1, freedoms / 2) + special.polygamma(1, error_freedoms / 2))
    )
    if excess <= 0:
        return float(freedoms @ departures / freedoms.sum()), _MAX_FREEDOM

    def subtract_excess(log_half: float) -> float:
        return float(special.polygamma(1, np.exp(log_half))) - excess

    half_freedom = (
        float(np.exp(optimize.brentq(subtract_excess, -20.0, log(_MAX_FREEDOM / 2))))
        if subtract_excess(log(_MAX_FREEDOM / 2)) < 0
        else inf
    )
    freedom = min(2 * half_freedom, _MAX_FREEDOM)
    return float(np.exp(np.mean(logs) + _expect_log(np.array([freedom]))[0])), freedom


def _expect_log(freedoms: Array) -> Array:
    """Return the expected logarithm of χ²_f/f."""
    logs: Array = special.digamma(freedoms / 2) - np.log(freedoms / 2)
    return logs


def add_sessions(additive: Fit, sessions: SessionMeans, ratio: SessionRatio) -> Fit:
    """Return the fit with sessions as a random effect; the session ratio 1 + ρk determines their variance."""
    gain = sessions.departure().gain
    rho = (ratio.value - 1) / gain
    weights = np.linalg.inv(sessions.covariance + rho * np.eye(len(sessions.means)))
    weighted = sessions.columns.T @ weights
    covariance = np.asarray(np.linalg.inv(weighted @ sessions.columns), dtype=np.float64)
    reach = covariance @ weighted
    effects = additive.effects.copy()
    effects[additive.design.independent_columns()] += reach @ sessions.means
    session_deviation = sqrt(rho * sessions.variance)
    return replace(
        additive,
        model=Model.SESSIONS,
        effects=effects,
        covariance=sessions.variance * covariance,
        small=SessionVariance(
            covariance=covariance,
            slope=reach @ reach.T,
            share=rho + 1 / gain,
            reach=reach,
            means=sessions,
            session_freedom=ratio.freedom,
            scatter=None if additive.scatter is None else additive.small,
        ),
        session_deviation=session_deviation,
    )
