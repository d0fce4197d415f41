"""Signal-to-noise ratio of the single readings, and the drift of all of them together."""

from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import refuse_unknown

_FEWEST_FRAMES: Final = 3


class ChannelNoise:
    """``channel_snr`` [dB], median and worst over the imaged readings, and ``drift`` [%/min] of the unloaded sheet.

    A reading's ratio is its mean's size over its rms deviation from a straight line in time, so that drift counts
    once, as drift. Drift is the slope of the frames' common scale against the reference. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"channel_snr": "dB", "drift": "%/min"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("channel-noise", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; fewer than three unloaded frames, or frames that are all alike, give no ratio."""
        count = len(run.unloaded)
        if count < _FEWEST_FRAMES:
            why = f"{count} unloaded frames are too few; {_FEWEST_FRAMES} are needed"
            snr = [Measurement("channel_snr", None, "dB", qualifier=q, how=why) for q in ("median", "worst")]
            return (*snr, Measurement("drift", None, "%/min", how=why))
        return (*_signal_to_noise(run), _drift(run))


def _signal_to_noise(run: RunObservation) -> tuple[Measurement, Measurement]:
    readings = run.unloaded.voltages[:, run.usable]
    level = np.abs(readings.mean(axis=0))
    left = _without_line(run.unloaded.time_s, readings)
    noise = np.sqrt((left**2).sum(axis=0) / (len(readings) - 2))
    heard = (noise > 1e-13 * level.max(initial=0.0)) & (level > 0)
    if not heard.any():
        why = "the unloaded frames do not differ: there is no noise to compare with"
        return (
            Measurement("channel_snr", None, "dB", qualifier="median", how=why),
            Measurement("channel_snr", None, "dB", qualifier="worst", how=why),
        )
    ratio_dB = 20 * np.log10(level[heard] / noise[heard])
    drive, measure = np.argwhere(run.usable)[np.flatnonzero(heard)[int(ratio_dB.argmin())]]
    silent = int((~heard).sum())
    how = f"{len(ratio_dB)} imaged readings, {len(readings)} frames" + (f"; {silent} without noise" if silent else "")
    return (
        Measurement("channel_snr", float(np.median(ratio_dB)), "dB", qualifier="median", how=how),
        Measurement(
            "channel_snr",
            float(ratio_dB.min()),
            "dB",
            qualifier="worst",
            how=f"drive pair {drive}, measure pair {measure}",
        ),
    )


def _drift(run: RunObservation) -> Measurement:
    reference = run.reference[run.usable]
    scale = run.unloaded.voltages[:, run.usable] @ reference / (reference @ reference)
    time_min = (run.unloaded.time_s - run.unloaded.time_s.mean()) / 60
    spread = float(time_min @ time_min)
    if spread == 0:
        return Measurement("drift", None, "%/min", how="the unloaded frames carry one and the same time")
    slope = float(time_min @ scale) / spread
    left = scale - scale.mean() - slope * time_min
    stderr = float(np.sqrt(left @ left / (len(scale) - 2) / spread))
    return Measurement(
        "drift", 100 * slope, "%/min", 100 * stderr, how="slope of the unloaded frames' scale against the reference"
    )


def _without_line(time_s: NDArray[np.float64], readings: NDArray[np.float64]) -> NDArray[np.float64]:
    q, _ = np.linalg.qr(np.column_stack([np.ones(len(time_s)), time_s - time_s.mean()]))
    centred = readings - readings.mean(axis=0)
    left: NDArray[np.float64] = centred - q @ (q.T @ centred)
    return left
