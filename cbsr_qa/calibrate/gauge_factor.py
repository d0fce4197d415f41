"""The gauge factor of a sheet from presses all over it: contrast under the head against strain."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.common_relaxation import CommonRelaxation
from cbsr_qa.calibrate.data_sheet import Estimate
from cbsr_qa.calibrate.response_average import average_response
from cbsr_qa.calibrate.response_map import learn_response
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.sensor import QuasiStatic

Array = NDArray[np.float64]

#: Strains must differ by this factor for an intercept to be told from the map, which is not known better than this
#: before any load was seen.
_SPREAD: Final = 2.0
_UNKNOWN_INTERCEPT: Final = 0.02


def sheet_gauge_factor(
    places_mm: Array,
    contrast: Array,
    relative_variance: Array,
    strain: Array,
    line: QuasiStatic,
    *,
    radius_mm: float,
    sheet_mm: Array,
) -> Estimate:
    """Estimate the mean over a sheet of the local gauge factor, α_ε times the relative response of each place.

    κ = S (α_ε ε + β_ε) (paper Eqs 1 and 7, against strain): ln S is learned as in
    :func:`~cbsr_qa.calibrate.response_map.learn_response`, where strains differ together with an error of β_ε.

    Parameters
    ----------
    places_mm, contrast, relative_variance, strain : (n, 2), (n,), (n,), (n,) of loads whose contrast has the sign of
        α_ε.
    line : nominal α_ε and β_ε; only β_ε stays an assumption, and only where all strains are alike.
    radius_mm : of the sheet.
    sheet_mm : (m, 2) places to average over, see :func:`~cbsr_qa.calibrate.response_average.sheet_places`.

    Raises
    ------
    CalibrationError
        If there are fewer than 3 loads, or the line predicts no change, or one of the other sign, for one of them.
    """
    predicted = line.slope.value * strain + line.intercept.value
    if not ((predicted * contrast) > 0).all():
        raise CalibrationError(
            f"the line {line.slope.value:.3g} ε {line.intercept.value:+.3g} predicts no change of the sign seen"
            f" at {int((predicted * contrast <= 0).sum())} of {len(strain)} loads: they say nothing about a response",
            remedy="press harder, where α ε + β is clear of zero",
        )
    middle = float(np.exp(np.log(np.abs(predicted)).mean()) * np.sign(predicted[0])) if len(predicted) else 1.0
    apart = len(strain) > 0 and strain.max() >= _SPREAD * strain.min()
    response = learn_response(
        places_mm,
        np.log(contrast / predicted),
        relative_variance,
        radius_mm=radius_mm,
        bend=1 / predicted - 1 / middle if apart else None,
        bend_stderr=line.intercept.stderr or _UNKNOWN_INTERCEPT,
    )
    change, variance = response.bend
    slope = line.slope.value * (1 - change / middle)
    log_mean, log_variance = average_response(response, sheet_mm)
    pointwise, _ = response.predict(sheet_mm)
    shape = float(np.exp(pointwise - log_mean).mean())  # a mean of responses, not of their logarithms
    value = slope * float(np.exp(log_mean)) * shape
    turned = line.slope.value / middle / slope
    return Estimate(value, abs(value) * float(np.sqrt(log_variance + turned**2 * variance)), len(strain) - 1)


def steady_share(common: CommonRelaxation, time_s: Array) -> Estimate:
    """Where a hold ends over what is seen of it at some times after its ramp, by the relaxation all loads share.

    Parameters
    ----------
    time_s : (n,) of the frames that were averaged.

    Raises
    ------
    NumericsError
        If the traces carry no relaxation that ends, or it ends where it began.
    """
    fit = common.fit
    if not len(common.shares):
        raise NumericsError(f"it is not known where holds end: {fit.why}", remedy="hold longer")
    count = len(fit.amplitudes)
    start = np.concatenate([[fit.offset], fit.amplitudes, np.log(fit.time_constants_s)])

    def share(values: Array) -> float:
        decays = np.exp(-np.asarray(time_s)[:, None] / np.exp(values[1 + count :]))
        return float(values[0] / (values[0] + (decays @ values[1 : 1 + count]).mean()))

    value = share(start)
    if not np.isfinite(value) or value <= 0:
        raise NumericsError("it is not known where holds end: the change they end at is about zero")
    steps = 0.01 * np.sqrt(np.diag(common.covariance))
    gradient = np.array(
        [
            0.0 if step == 0 else (share(start + step * unit) - share(start - step * unit)) / (2 * step)
            for step, unit in zip(steps, np.eye(len(start)), strict=True)
        ]
    )
    return Estimate(value, float(np.sqrt(max(gradient @ common.covariance @ gradient, 0.0))), common.traces)
