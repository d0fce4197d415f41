"""Small-sample covariance and degrees of freedom of the fixed effects of a model with a random sensor.

With V = σ²(I + θZZᵀ), Φ = (XᵀV⁻¹X)⁻¹, the covariance W of the two variances' estimates (inverse of the expected
restricted information), P_i = −XᵀV⁻¹V_iV⁻¹X and Q_ij = XᵀV⁻¹V_iV⁻¹V_jV⁻¹X,

    Φ_A = Φ + 2 Φ {Σ_ij W_ij (Q_ij − P_i Φ P_j)} Φ

allows for the variances being estimated. A contrast has Satterthwaite's degrees of freedom (Kenward & Roger 1997,
sections 2 and 3). Everything is in units of σ², which cancels.
"""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.sensor_sums import SensorSums


@dataclass(frozen=True, slots=True, eq=False)
class SmallSample:
    """Covariances over σ² of p fixed effects, and what their degrees of freedom are worked out from.

    Parameters
    ----------
    plain, adjusted : (p, p) ndarrays, Φ/σ² and Φ_A/σ².
    slopes : (2, p, p) ndarray, P of run and sensor variance.
    variances : (2, 2) ndarray, W/σ⁴.
    """

    plain: Array
    adjusted: Array
    slopes: Array
    variances: Array

    def freedom(self, contrast: Array) -> float:
        """Return the degrees of freedom of one contrast, (p,) → number: 2 / Σ W_ij t_i t_j, t_i = lᵀΦP_iΦl / lᵀΦl."""
        row = self.plain @ contrast
        traces = np.array([row @ slope @ row for slope in self.slopes]) / float(contrast @ row)
        return 2 / float(traces @ self.variances @ traces)


def small_sample(sums: SensorSums, ratio: float) -> SmallSample:
    """Return the covariances at a ratio of variances θ ≥ 0."""
    inner = sums.within[:-1, :-1]

    def between(power: int, times: int) -> Array:
        return sums.products(ratio, power, times)[:-1, :-1]

    plain = np.asarray(np.linalg.inv(inner + between(1, 0)), dtype=np.float64)
    slopes: Array = -np.stack([inner + between(2, 0), between(2, 1)])
    mixed = between(3, 1)
    curves: Array = np.array([[inner + between(3, 0), mixed], [mixed, between(3, 2)]])
    variances = np.asarray(np.linalg.inv(_information(sums, ratio, plain, slopes, curves)), dtype=np.float64)
    squares = (slopes @ plain)[:, None] @ slopes
    lost = np.einsum("ij,ijkl->kl", variances, curves - squares)
    adjusted = plain + 2 * plain @ lost @ plain
    return SmallSample(plain, 0.5 * (adjusted + adjusted.T), slopes, variances)


def _information(sums: SensorSums, ratio: float, plain: Array, slopes: Array, curves: Array) -> Array:
    """Expected restricted information ½ [tr(V⁻¹V_iV⁻¹V_j) − 2 tr(ΦQ_ij) + tr(ΦP_iΦP_j)] of both variances."""
    inside = sums.runs - sums.total_sensors
    traces = np.array(
        [
            [inside + sums.trace(ratio, 2, 0), sums.trace(ratio, 2, 1)],
            [sums.trace(ratio, 2, 1), sums.trace(ratio, 2, 2)],
        ]
    )
    turned = [plain @ slope for slope in slopes]
    crossed = np.array([[np.sum(one * two.T) for two in turned] for one in turned])
    fitted = np.einsum("ab,ijba->ij", plain, curves)
    information: Array = 0.5 * (traces - 2 * fitted + crossed)
    return information
