"""Noise figure of a linear imaging matrix: how much signal-to-noise ratio the image has lost."""

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError

Array = NDArray[np.float64]


class NoiseFigureForm(StrEnum):
    """Which of the two forms in use; a report names it."""

    ADLER_2009 = "Adler et al. 2009"  #: rms noise from the propagated covariance
    EIDORS = "EIDORS"  #: mean over channels of the deviation over elements, 2–20 % lower


def noise_figure(
    matrix: Array,
    signal: Array,
    areas: Array,
    *,
    noise_variance: Array | None = None,
    form: NoiseFigureForm = NoiseFigureForm.ADLER_2009,
) -> float:
    """NF = SNR of the readings over SNR of the image, each mean|signal| over rms noise.

    Parameters
    ----------
    matrix : (e, m) R.
    signal : (m,) y of a small central target.
    areas : (e,) weights A of the image, in any unit.
    noise_variance : (m,) of the readings, for the 2009 form only; None for equal noise on every channel.
    form : 2009: (mean|y| / √mean v) / (mean|A R y| / √(Σ(A R)² v / e)).
        EIDORS: noise on one channel c at a time, deviations with the mean removed over channels or elements and
        ddof 1, (mean|y| / mean_c std(n_c)) / (mean|A R y| / mean_c std(A R n_c)).

    Raises
    ------
    NumericsError
        If the matrix does not see the signal at all, or variances are given for EIDORS's form, which has none.
    """
    weighted = areas[:, None] * matrix
    response = float(np.abs(weighted @ signal).mean())
    if not (np.isfinite(response) and response > 0):
        raise NumericsError(
            "the noise figure is not defined: the matrix does not see the target",
            remedy="check the hyperparameter and which channels are masked",
        )
    level = float(np.abs(signal).mean())
    if form is NoiseFigureForm.EIDORS:
        if noise_variance is not None:
            raise NumericsError(
                "the EIDORS form of the noise figure knows equal noise only",
                remedy="take the form of Adler et al. 2009",
            )
        channel = np.std(np.eye(len(signal))[0], ddof=1)
        return level / float(channel) * float(np.std(weighted, axis=0, ddof=1).mean()) / response
    variance = np.ones(len(signal)) if noise_variance is None else noise_variance
    noise = np.sqrt(np.einsum("em,em,m->", weighted, weighted, variance) / len(areas))
    return level / float(np.sqrt(variance.mean())) * float(noise) / response
