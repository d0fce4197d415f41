"""One-step images of consecutive frames with a temporal prior: slow materials change little between frames.

The prior of a block of images is P = R⁻¹ between elements times Γ between frames, Γ_ts = a^|t−s| with a = exp(−1/τ)
(Adler, Dai & Lionheart 2007). In the coordinates of the dual spectrum the block decouples into one autoregressive
sequence per eigenvector, of variance Λ and observed with noise λ²: a scalar Kalman filter and Rauch–Tung–Striebel
smoother give the estimate exactly. a = 0 is the one-step image of each frame by itself; with a = 1 all frames are one
image.
"""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.imaging import ImagingProblem, ParameterChoice, check_readings
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.dual import DualSpectrum
from cbsr_qa.eit.inverse.noise_figures import central_signal

_LASTS = 8  # correlation times after which a frame is forgotten
_LONGEST = 400  # frames a response is followed for at most


@dataclass(frozen=True, slots=True)
class Correlation:
    """Correlation of frames.

    Parameters
    ----------
    frames : correlation time τ in frames, at least 0; 0 for independent frames, ∞ for one lasting image.
    lag : later frames an image may use, at least 0; None for all of the block.
    """

    frames: float
    lag: int | None = None

    @property
    def between(self) -> float:
        """Correlation a of one frame with the next."""
        return float(np.exp(-1 / self.frames)) if self.frames > 0 else 0.0

    @property
    def anew(self) -> float:
        """Share of the variance that is new in each frame, 1 − a², computed without cancellation for long times."""
        return float(-np.expm1(-2 / self.frames)) if self.frames > 0 else 1.0


def smooth(readings: Array, values: Array, ridge: float, correlation: Correlation) -> Array:
    """Coefficients of eigenvectors from a block of frames.

    Parameters
    ----------
    readings : (n, k) coefficients of the eigenvectors, in the order of the frames.
    values : (k,) Λ ≥ 0. ridge : λ² > 0.

    Returns
    -------
    (n, k) float64, estimates of each sequence over Λ: y/(Λ + λ²) for independent frames.
    """
    a, anew = correlation.between, correlation.anew
    filtered = np.empty_like(readings)
    smoother_gains = np.empty_like(readings)  # smoother gains from each frame's successor
    estimate, spread = np.zeros(readings.shape[1]), np.ones(readings.shape[1])  # variance in units of Λ
    for frame, reading in enumerate(readings):
        estimate, ahead = a * estimate, a * a * spread + anew
        if frame:
            smoother_gains[frame - 1] = a * spread / ahead
        estimate = estimate + ahead / (values * ahead + ridge) * (reading - values * estimate)
        spread = ahead * ridge / (values * ahead + ridge)
        filtered[frame] = estimate
    return _smooth_backwards(filtered, smoother_gains, a, correlation.lag)


def _smooth_backwards(filtered: Array, back: Array, a: float, lag: int | None) -> Array:
    """Smooth each frame with later ones, up to a lag."""
    count = len(filtered)
    if lag is None or lag >= count - 1:
        smooth = filtered.copy()
        for frame in range(count - 2, -1, -1):
            smooth[frame] += back[frame] * (smooth[frame + 1] - a * filtered[frame])
        return smooth
    frames = np.arange(count)
    last_frames = np.minimum(frames + lag, count - 1)
    smooth = filtered[last_frames]
    for behind in range(1, lag + 1):
        has_successor = last_frames - behind >= frames
        earlier_frames = (last_frames - behind)[has_successor]
        smooth[has_successor] = filtered[earlier_frames] + back[earlier_frames] * (
            smooth[has_successor] - a * filtered[earlier_frames]
        )
    return smooth


@dataclass(frozen=True, slots=True, eq=False)
class TemporalImages:
    """A prepared method, see :class:`~cbsr_qa.domain.imaging.PreparedReconstruction`.

    Images of a block are linear in the block. Frames are assumed evenly spaced.

    Parameters
    ----------
    choice : choice of λ, for single frames.
    spectrum : spectrum of all used readings.
    """

    method: str
    problem: ImagingProblem
    choice: ParameterChoice
    spectrum: DualSpectrum
    correlation: Correlation
    linear: bool = True

    def images(self, changes: Array) -> Array:
        """Images (n, e) of scaled changes (n, m) of consecutive frames.

        RefusedError if readings do not fit or are not finite.
        """
        readings = check_readings(changes, self.problem) @ self.spectrum.analysis.T
        coefficients = smooth(readings, self.spectrum.values, self.choice.value**2, self.correlation)
        return coefficients @ self.spectrum.basis.T


def lasting_noise_figure(
    problem: ImagingProblem, spectrum: DualSpectrum, hyperparameter: float, correlation: Correlation
) -> float:
    """Noise figure (Adler et al. 2009) of a lasting change, amid a long block; 0 for one lasting image."""
    if np.isinf(correlation.frames):
        return 0.0
    reach = min(_LONGEST, int(np.ceil(_LASTS * correlation.frames)) + 1)
    pulse = np.zeros((2 * reach + 1, len(spectrum.values)))
    pulse[reach] = 1
    response = smooth(pulse, spectrum.values, hyperparameter**2, correlation)
    signal = central_signal(problem)
    variance = 1.0 if problem.noise_variance is None else float(problem.noise_variance.mean())
    weighted = problem.mesh.areas_mm2[:, None] * spectrum.basis
    noise = np.sqrt((weighted**2 @ (response**2).sum(axis=0)).sum() / len(weighted))
    image = weighted @ (response.sum(axis=0) * (spectrum.analysis @ signal))
    return float(np.abs(signal).mean() / np.sqrt(variance) * noise / np.abs(image).mean())
