"""Signal-to-noise ratio of the single readings, and the drift of all of them together."""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.channel_quality import FEWEST_FRAMES, signal_to_noise_dB
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._shared import flag, refuse_unknown


class ChannelNoise:
    """``channel_snr`` [dB], median and worst over the imaged readings, and ``drift`` [%/min] of the unloaded sheet.

    A reading's ratio is its mean's size over its rms deviation from a straight line in time, so that drift counts
    once, as drift. Drift is the slope of the frames' common scale against the reference. With the option
    ``every = true`` each imaged reading's ratio is a measurement of its own, ``"drive 3, measure 7"``.
    """

    measures: ClassVar[dict[str, str]] = {"channel_snr": "dB", "drift": "%/min"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("channel-noise", options, ("every",))
        self._every = flag("channel-noise", options, "every")

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; fewer than three unloaded frames, or frames that are all alike, give no ratio."""
        ratio_dB = signal_to_noise_dB(run.unloaded)
        if ratio_dB is None:
            why = f"{len(run.unloaded)} unloaded frames are too few; {FEWEST_FRAMES} are needed"
            return (*_no_ratio(why), Measurement("drift", None, "%/min", how=why))
        every = _each(ratio_dB, run) if self._every else ()
        return (*_together(ratio_dB, run), *every, _drift(run))


def _together(ratio_dB: NDArray[np.float64], run: RunObservation) -> tuple[Measurement, ...]:
    heard = np.isfinite(ratio_dB) & run.usable
    if not heard.any():
        return _no_ratio("the unloaded frames do not differ: there is no noise to compare with")
    drive, measure = np.argwhere(heard)[int(ratio_dB[heard].argmin())]
    silent = int(run.usable.sum() - heard.sum())
    how = f"{int(heard.sum())} imaged readings, {len(run.unloaded)} frames"
    how += f"; {silent} without noise or level" if silent else ""
    where = f"drive pair {drive}, measure pair {measure}"
    return (
        Measurement("channel_snr", float(np.median(ratio_dB[heard])), "dB", qualifier="median", how=how),
        Measurement("channel_snr", float(ratio_dB[heard].min()), "dB", qualifier="worst", how=where),
    )


def _each(ratio_dB: NDArray[np.float64], run: RunObservation) -> tuple[Measurement, ...]:
    how = f"{len(run.unloaded)} frames"
    return tuple(
        Measurement(
            "channel_snr",
            float(ratio_dB[drive, measure]) if np.isfinite(ratio_dB[drive, measure]) else None,
            "dB",
            qualifier=f"drive {drive}, measure {measure}",
            how=how if np.isfinite(ratio_dB[drive, measure]) else "it has no noise, or no level",
        )
        for drive, measure in np.argwhere(run.usable).tolist()
    )


def _no_ratio(why: str) -> tuple[Measurement, ...]:
    return tuple(Measurement("channel_snr", None, "dB", qualifier=q, how=why) for q in ("median", "worst"))


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
