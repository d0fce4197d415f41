"""Spikes: single readings that jump for a frame or so.

A converter, a multiplexer or a cable now and then delivers one reading that has nothing to do with the sheet. It
stands out of its own neighbours in time, as a short press does; what tells them apart is the reciprocal reading
(:mod:`cbsr_qa.domain.readings.rules`).

Source: Hampel's identifier (distance from the running median over the noise); F. R. Hampel, "The influence curve and
its role in robust estimation", J. Am. Stat. Assoc. 69 (1974) 383–393. Departure: the scale is the channel's noise
over the whole recording, not that of the window, which a quiet handful of frames would underestimate.
"""

import numpy as np
from scipy.ndimage import median_filter

from cbsr_qa.analysis.defects.noise import MAD_TO_SIGMA, channel_noise
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.readings.rules import MOST_SPIKES, SPIKE_SIGMA, reciprocal_unchanged

_HALF_WINDOW = 3  #: frames on either side: spikes of up to three frames are seen


def remove_spikes(voltages: Array, usable: Mask, *, counts: bool) -> tuple[Array, Mask]:
    """Replace spikes by the running median of their channel.

    Parameters
    ----------
    voltages : (n, drives, measures), carry-over taken out.
    usable : (drives, measures) bool, channels whose spikes are replaced; others stay as they are.
    counts : whether the values are whole counts.

    Returns
    -------
    The readings, and which of them were replaced, (n, drives, measures) bool.
    """
    n = len(voltages)
    if n < 2 * _HALF_WINDOW + 2 or not usable.any():
        return voltages, np.zeros(voltages.shape, dtype=bool)
    level = np.array(voltages)
    level[:, usable] = median_filter(voltages[:, usable], size=(2 * _HALF_WINDOW + 1, 1), mode="mirror")
    sigma = np.ones(usable.shape)
    sigma[usable] = channel_noise(voltages[:, usable], counts=counts)
    deviation = voltages - level
    # Where most readings of a frame are far from their neighbours in time, the noise has grown, or the sheet moved.
    unrest = MAD_TO_SIGMA * np.median(np.abs(deviation[:, usable]) / sigma[usable], axis=1)
    far_mask = (np.abs(deviation) > SPIKE_SIGMA * sigma * np.maximum(unrest, 1.0)[:, None, None]) & usable
    spikes = far_mask & _lacks_reciprocal(deviation, far_mask, usable)
    return np.where(spikes, level, voltages), spikes


def _lacks_reciprocal(apart: Array, far: Mask, usable: Mask) -> Mask:
    """Whether the reciprocal of a reading did not change with it."""
    square = usable.shape[0] == usable.shape[1]
    partner_mask = usable & usable.T if square else np.zeros_like(usable)
    few = (far.sum(axis=(1, 2)) <= MOST_SPIKES * usable.sum())[:, None, None]
    alone_mask: Mask = np.broadcast_to(few, far.shape)
    if square:
        alone_mask = np.where(partner_mask, reciprocal_unchanged(apart, apart.swapaxes(1, 2)), alone_mask)
    return alone_mask
