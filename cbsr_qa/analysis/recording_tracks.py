"""Whether an object that was followed through frames moves, and how."""

from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import Electrodes
from cbsr_qa.domain.load_events import Motion

Array = NDArray[np.float64]

_LEAST_R: Final = 0.1  #: of the radius: what stays within it has not moved
_JITTERS: Final = 4.0  #: and so many times the scatter from frame to frame
_FEWEST: Final = 5  #: frames
_SMOOTHED: Final = 8  #: a track is smoothed over this share of its frames, or three


def motion_of(track: tuple[tuple[float, float, float], ...], layout: Electrodes) -> Motion | None:
    """Say how an object moves.

    Parameters
    ----------
    track : (time_s, x_over_R, y_over_R) per frame.
    layout : numbers directions.

    Returns
    -------
    None where it stays, or where there are fewer than five frames to tell that from scatter. It moves if, smoothed
    by a running median, it is ever further from where it began than a tenth of the radius and than four times the
    scatter; scatter is that of second differences, which a steady motion leaves at zero.
    """
    places = np.array([place[1:] for place in track], dtype=np.float64).reshape(-1, 2)
    if len(places) < _FEWEST:
        return None
    smooth = _running_median(places)
    jitter = float(np.sqrt(np.mean(np.diff(places, 2, axis=0) ** 2) / 6))
    if np.hypot(*(smooth - smooth[0]).T).max() < max(_LEAST_R, _JITTERS * jitter):
        return None
    numbers = np.array([layout.electrode_at(float(x), float(y)) for x, y in places])
    along = np.unwrap(numbers, period=layout.count)
    radii = np.hypot(*places.T)
    return Motion(
        begins=(float(numbers[0]), float(radii[0])),
        ends=(float(numbers[-1]), float(radii[-1])),
        turns=float(along[-1] - along[0]) / layout.count,
        nearest_r_over_R=float(np.hypot(*smooth.T).min()),
    )


def _running_median(places: Array) -> Array:
    """Median of each place (n, 2) with those around it; shorter by what has no neighbours."""
    window = max(3, len(places) // _SMOOTHED)
    median: Array = np.median(sliding_window_view(places, window, axis=0), axis=-1)
    return median
