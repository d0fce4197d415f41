"""Newton's steps rest on true derivatives, and lead to maxima."""

import numpy as np
from pressed_sheets import pressed_sheet

from cbsr_qa.calibration.presses.ascent import ascended
from cbsr_qa.calibration.presses.likeness import Likeness
from cbsr_qa.calibration.presses.weak_loads import ModelledSheet


def test_slopes_and_bends_of_likelihoods_are_those_of_differences():
    pressed = pressed_sheet(6, noise=0.3)
    likeness = Likeness(ModelledSheet(pressed.sensor), pressed.pairs, pressed.changes)
    places = np.random.default_rng(2).uniform(-1, 1, (40, 6, 2))  # some of them at the rim and beyond the sheet
    _, *slopes, xx, xy, yy = likeness.at(places)
    step = 1e-5
    for slope, bends, along in zip(slopes, [(xx, xy), (xy, yy)], step * np.eye(2), strict=True):
        change = (likeness.at(places + along) - likeness.at(places - along)) / (2 * step)
        np.testing.assert_allclose(slope, change[0], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(bends, change[1:3], rtol=1e-4, atol=1e-3)
    assert np.abs(slopes).max() > 1


def test_an_ascent_ends_at_the_nearest_maximum_and_leaves_saddles():
    def jet(at, which):
        """cos x cos y, stretched for every start: maxima where x and y are both multiples of π with an even sum."""
        scale = stretched[which]
        (x, y), one = at.T * scale, np.ones(len(at))
        value, mixed = np.cos(x) * np.cos(y), np.sin(x) * np.sin(y)
        slope = -np.stack([np.sin(x) * np.cos(y), np.cos(x) * np.sin(y)], axis=-1)
        bend = np.stack([np.stack([-value, mixed], -1), np.stack([mixed, -value * one], -1)], axis=-2)
        return value, slope * scale[:, None], bend * scale[:, None, None] ** 2

    stretched = np.array([1.0, 1.0, 2.0, 1.0])
    starts = np.array([[0.5, -0.7], [2.9, 3.6], [0.3, 0.2], [np.pi / 2 + 0.01, np.pi / 2 + 0.01]])
    at, value = ascended(jet, starts)
    np.testing.assert_allclose(value, 1, atol=1e-12)
    np.testing.assert_allclose(at[:3], [[0, 0], [np.pi, np.pi], [0, 0]], atol=1e-6)
    np.testing.assert_allclose(np.abs(at[3] - np.pi / 2), np.pi / 2, atol=1e-6)
