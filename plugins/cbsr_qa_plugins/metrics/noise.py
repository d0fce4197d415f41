"""Noise metrics: noise figure, noise of the unloaded images, signal-to-noise ratio and drift of the readings."""

from typing import ClassVar, Final

import numpy as np

from cbsr_qa.analysis.defects.quality import FEWEST_FRAMES, signal_to_noise_dB, subtract_trend
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.scaling import changes
from cbsr_qa.plugin import Dimensions, LoadObservation, Measurement, PluginOptions, Role, RunObservation, WithOptions

#: Frames that leave a scatter worth the name.
_MIN_FRAMES: Final = 4


class NoiseFigure:
    """``noise_figure`` [1] of the run, Adler et al. 2009 form: NF = SNR_v / SNR_x.

    The matrix is the run's; noise is the covariance of its rested, unloaded frames, slow drift taken out; the
    signal is the change measured under the presses at the sheet's centre (of the phases made for noise, where
    there are any), or else the model's response to a small central target. ``how`` names which. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"noise_figure": "1"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        scatter = _noise(run)
        if scatter is None:
            return (_refuse_noise_figure(f"fewer than {_MIN_FRAMES} unloaded frames to take the noise from"),)
        if not scatter.any():
            return (_refuse_noise_figure("the unloaded frames do not differ: there is no noise to propagate"),)
        signals, phase, source = _signals(run)
        gains = np.empty(len(signals))
        for number, signal in enumerate(signals):
            # mean|y| over mean|A x|, with the signal y, its image x and the elements' areas A.
            gains[number] = np.abs(signal).mean() / np.abs(_weigh_by_area(run, signal[None])).mean()
        # Mean square of each noise frame, of its readings and of its area-weighted image.
        readings, images = (scatter**2).mean(axis=1), (_weigh_by_area(run, scatter) ** 2).mean(axis=1)
        figures = gains * np.sqrt(images.mean() / readings.mean())
        without = gains[0] * np.sqrt((images.sum() - images) / (readings.sum() - readings))  # one frame left out
        between = float(figures.std(ddof=1)) if len(figures) > 1 else 0.0
        jackknife = np.sqrt((len(without) - 1) * without.var())
        uncertainty = float(np.hypot(between / np.sqrt(len(figures)), jackknife))
        how = f"Adler et al. 2009 form; measured covariance of {len(scatter)} unloaded frames; signal: {source}"
        return (Measurement("noise_figure", float(figures.mean()), "1", uncertainty, phase=phase, how=how),)


def _refuse_noise_figure(why: str) -> Measurement:
    return Measurement("noise_figure", None, "1", how=why)


def _noise(run: RunObservation) -> Array | None:
    """Scatter of the used readings about a straight line in time, (k, m), scaled to its degrees of freedom."""
    frames = run.unloaded
    if len(frames) < _MIN_FRAMES:
        return None
    readings = changes(frames.voltages, run.reference, run.reconstruction.problem, run.scale)
    residuals = subtract_trend(readings, frames.time_s)
    # Rounding of identical frames is not noise.
    if np.abs(residuals).max() <= 1e-12 * np.abs(run.reconstruction.problem.reference).max():
        return np.zeros_like(residuals)
    residuals *= np.sqrt(len(frames) / (len(frames) - 2))
    return residuals


def _signals(run: RunObservation) -> tuple[list[Array], str, str]:
    """Signals y (m,), the phase they are from, and in words what they are."""
    centre = [load for load in run.loads if np.hypot(*load.place_mm) < 0.5]
    noise_phases = {phase.name for phase in run.record.phases if phase.role is Role.NOISE}
    chosen = [load for load in centre if load.phase in noise_phases] or centre
    measured = [signal for load in chosen if (signal := _measure_change(load, run)) is not None]
    if measured:
        where = {load.phase for load in chosen}
        phase = where.pop() if len(where) == 1 else ""
        return measured, phase, f"measured change of {len(measured)} presses at the centre"
    problem = run.reconstruction.problem
    distance = np.hypot(*problem.mesh.centroids_mm.T)
    target = distance <= max(run.record.indenter.radius_mm, float(distance.min()))
    return [problem.jacobian @ target.astype(np.float64)], "", "the model's response to a central target"


def _measure_change(load: LoadObservation, run: RunObservation) -> Array | None:
    frames = run.record.phase(load.phase).frames
    if frames is None or load.steady_frames < 1:
        return None
    held_frames = frames.select_interval(load.record.hold_start_s, load.record.release_start_s)
    if not len(held_frames):
        return None
    steady = held_frames.select(slice(-load.steady_frames, None)).voltages
    readings = changes(steady, run.reference, run.reconstruction.problem, run.scale)
    change: Array = readings.mean(axis=0)
    return change if change.any() else None


def _weigh_by_area(run: RunObservation, readings: Array) -> Array:
    """Images times the area of their elements, (k, elements)."""
    images: Array = run.reconstruction.images(readings) * run.reconstruction.problem.mesh.areas_mm2
    return images


class ImageNoise:
    """``noise_floor`` and ``conductance_noise`` σ_n of the run, both relative conductance changes [1].

    σ_n is the standard deviation over time of the unloaded images: without qualifier of their area-weighted mean,
    with ``"per element"`` the rms of the single elements'. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"noise_floor": "1", "conductance_noise": "1"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; σ_n needs two unloaded frames."""
        frames = len(run.noise_images)
        floor = Measurement(
            "noise_floor", run.noise_floor, "1", how=f"largest |value| of any element in {frames} unloaded images"
        )
        return (floor, *_over_time(run))


def _over_time(run: RunObservation) -> tuple[Measurement, Measurement]:
    name, count = "conductance_noise", len(run.unloaded)
    if count < 2:
        why = f"{count} unloaded frames do not show a deviation over time; two are needed"
        return Measurement(name, None, "1", how=why), Measurement(name, None, "1", qualifier="per element", how=why)
    problem = run.reconstruction.problem
    images = run.reconstruction.images(changes(run.unloaded.voltages, run.reference, problem, run.scale))
    weights = problem.mesh.areas_mm2 / problem.mesh.areas_mm2.sum()
    total = float((images @ weights).std(ddof=1))
    single = float(np.sqrt(images.var(axis=0, ddof=1) @ weights))
    # Relative standard error of a standard deviation of normal noise.
    relative = 1 / np.sqrt(2 * (count - 1))
    how = f"standard deviation over {count} unloaded frames"
    return (
        Measurement(name, total, "1", total * relative, how=f"{how} of the area-weighted mean image"),
        Measurement(name, single, "1", single * relative, qualifier="per element", how=f"{how}, rms over the area"),
    )


class ChannelNoise(WithOptions):
    """``channel_snr`` [dB], median and worst over the imaged readings, and ``drift`` [%/min] of the unloaded sheet.

    A reading's ratio is its mean's size over its rms deviation from a straight line in time, so that drift counts
    once, as drift. Drift is the slope of the frames' common scale against the reference.

    Parameters
    ----------
    every : whether each imaged reading's ratio is reported too, ``"drive 3, measure 7"``.
    """

    class Options(PluginOptions):
        every: bool = False

    measures: ClassVar[dict[str, str]] = {"channel_snr": "dB", "drift": "%/min"}
    options: Options

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; fewer than three unloaded frames, or identical frames, give no ratio."""
        ratio_dB = signal_to_noise_dB(run.unloaded)
        if ratio_dB is None:
            why = f"{len(run.unloaded)} unloaded frames are too few; {FEWEST_FRAMES} are needed"
            return (*_refuse_snr(why), Measurement("drift", None, "%/min", how=why))
        every = _each(ratio_dB, run) if self.options.every else ()
        return (*_together(ratio_dB, run), *every, _drift(run))


def _together(ratio_dB: Array, run: RunObservation) -> tuple[Measurement, ...]:
    heard = np.isfinite(ratio_dB) & run.usable
    if not heard.any():
        return _refuse_snr("the unloaded frames do not differ: there is no noise to compare with")
    drive, measure = np.argwhere(heard)[int(ratio_dB[heard].argmin())]
    silent = int(run.usable.sum() - heard.sum())
    how = f"{int(heard.sum())} imaged readings, {len(run.unloaded)} frames"
    how += f"; {silent} without noise or level" if silent else ""
    where = f"drive pair {drive}, measure pair {measure}"
    return (
        Measurement("channel_snr", float(np.median(ratio_dB[heard])), "dB", qualifier="median", how=how),
        Measurement("channel_snr", float(ratio_dB[heard].min()), "dB", qualifier="worst", how=where),
    )


def _each(ratio_dB: Array, run: RunObservation) -> tuple[Measurement, ...]:
    how = f"{len(run.unloaded)} frames"
    measured = []
    for drive, measure in np.argwhere(run.usable).tolist():
        value, qualifier = float(ratio_dB[drive, measure]), Dimensions(drive=drive, measure=measure).text
        heard = np.isfinite(value)
        why = how if heard else "it has no noise, or no level"
        measured.append(Measurement("channel_snr", value if heard else None, "dB", qualifier=qualifier, how=why))
    return tuple(measured)


def _refuse_snr(why: str) -> tuple[Measurement, ...]:
    return tuple(Measurement("channel_snr", None, "dB", qualifier=q, how=why) for q in ("median", "worst"))


def _drift(run: RunObservation) -> Measurement:
    reference = run.reference[run.usable]
    scale = run.unloaded.voltages[:, run.usable] @ reference / (reference @ reference)
    time_min = (run.unloaded.time_s - run.unloaded.time_s.mean()) / 60
    spread = float(time_min @ time_min)
    if spread == 0:
        return Measurement("drift", None, "%/min", how="the unloaded frames carry one and the same time")
    slope = float(time_min @ scale) / spread
    residuals = scale - scale.mean() - slope * time_min
    stderr = float(np.sqrt(residuals @ residuals / (len(scale) - 2) / spread))
    return Measurement(
        "drift", 100 * slope, "%/min", 100 * stderr, how="slope of the unloaded frames' scale against the reference"
    )
