"""NF: how much of the readings' signal-to-noise ratio the image loses, with this sensor's own noise and signal."""

from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.steps import Role
from cbsr_qa.reconstruct.scaling import changes
from cbsr_qa_plugins.metrics._shared import refuse_unknown

#: Frames that leave a scatter worth the name.
_FEWEST_FRAMES: Final = 4


class NoiseFigure:
    """``noise_figure`` [1] of the run, Adler et al. 2009 form: NF = SNR_v / SNR_x.

    The matrix is the run's; noise is the covariance of its rested, unloaded frames, slow drift taken out; the
    signal is the change measured under the presses at the sheet's centre (of the phases made for noise, where
    there are any), or else the model's response to a small central target. ``how`` names which. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"noise_figure": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("noise-figure", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without noise there is no value."""
        scatter = _noise(run)
        if scatter is None:
            return (_refused(f"fewer than {_FEWEST_FRAMES} unloaded frames to take the noise from"),)
        if not scatter.any():
            return (_refused("the unloaded frames do not differ: there is no noise to propagate"),)
        signals, phase, source = _signals(run)
        figures = np.array([_figure(run, scatter, signal) for signal in signals])
        between = float(figures.std(ddof=1)) if len(figures) > 1 else 0.0
        uncertainty = float(np.hypot(between / np.sqrt(len(figures)), _jackknife(run, scatter, signals[0])))
        how = f"Adler et al. 2009 form; measured covariance of {len(scatter)} unloaded frames; signal: {source}"
        return (Measurement("noise_figure", float(figures.mean()), "1", uncertainty, phase=phase, how=how),)


def _refused(why: str) -> Measurement:
    return Measurement("noise_figure", None, "1", how=why)


def _noise(run: RunObservation) -> NDArray[np.float64] | None:
    """Scatter of the used readings about a straight line in time, (k, m), scaled to its degrees of freedom."""
    frames = run.unloaded
    if len(frames) < _FEWEST_FRAMES:
        return None
    readings = changes(frames.voltages, run.reference, run.reconstruction.problem, run.scale)
    line = np.column_stack([np.ones(len(frames)), frames.time_s - frames.time_s.mean()])
    q, _ = np.linalg.qr(line)
    left: NDArray[np.float64] = readings - q @ (q.T @ readings)
    # Rounding of frames that are all alike is no noise.
    if np.abs(left).max() <= 1e-12 * np.abs(run.reconstruction.problem.reference).max():
        return np.zeros_like(left)
    left *= np.sqrt(len(frames) / (len(frames) - 2))
    return left


def _signals(run: RunObservation) -> tuple[list[NDArray[np.float64]], str, str]:
    """Signals y (m,), the phase they are from, and in words what they are."""
    centre = [load for load in run.loads if np.hypot(load.record.load.x_mm, load.record.load.y_mm) < 0.5]
    noise_phases = {phase.name for phase in run.record.phases if phase.role is Role.NOISE}
    chosen = [load for load in centre if load.phase in noise_phases] or centre
    measured = [signal for load in chosen if (signal := _measured_change(load, run)) is not None]
    if measured:
        where = {load.phase for load in chosen}
        phase = where.pop() if len(where) == 1 else ""
        return measured, phase, f"measured change of {len(measured)} presses at the centre"
    problem = run.reconstruction.problem
    distance = np.hypot(*problem.mesh.centroids_mm.T)
    target = distance <= max(run.record.indenter.radius_mm, float(distance.min()))
    return [problem.jacobian @ target.astype(np.float64)], "", "the model's response to a central target"


def _measured_change(load: LoadObservation, run: RunObservation) -> NDArray[np.float64] | None:
    frames = run.record.phase(load.phase).frames
    if frames is None or load.steady_frames < 1:
        return None
    held = frames.between(load.record.hold_start_s, load.record.release_start_s)
    if not len(held):
        return None
    steady = held.select(slice(-load.steady_frames, None)).voltages
    readings = changes(steady, run.reference, run.reconstruction.problem, run.scale)
    change: NDArray[np.float64] = readings.mean(axis=0)
    return change if change.any() else None


def _figure(run: RunObservation, scatter: NDArray[np.float64], signal: NDArray[np.float64]) -> float:
    reading_noise, image_noise = _energies(run, scatter)
    return _gain(run, signal) * float(np.sqrt(image_noise.mean() / reading_noise.mean()))


def _jackknife(run: RunObservation, scatter: NDArray[np.float64], signal: NDArray[np.float64]) -> float:
    """Standard error of the figure from leaving out one noise frame at a time."""
    reading_noise, image_noise = _energies(run, scatter)
    without = (image_noise.sum() - image_noise) / (reading_noise.sum() - reading_noise)
    figures = _gain(run, signal) * np.sqrt(without)
    count = len(figures)
    return float(np.sqrt((count - 1) / count * ((figures - figures.mean()) ** 2).sum()))


def _energies(run: RunObservation, scatter: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean square of each noise frame, of its readings and of its area-weighted image."""
    areas = run.reconstruction.problem.mesh.areas_mm2
    images = run.reconstruction.images(scatter) * areas
    reading_noise: NDArray[np.float64] = (scatter**2).mean(axis=1)
    image_noise: NDArray[np.float64] = (images**2).mean(axis=1)
    return reading_noise, image_noise


def _gain(run: RunObservation, signal: NDArray[np.float64]) -> float:
    """mean|y| over mean|A x|."""
    areas = run.reconstruction.problem.mesh.areas_mm2
    image = run.reconstruction.images(signal[None])[0] * areas
    return float(np.abs(signal).mean() / np.abs(image).mean())
