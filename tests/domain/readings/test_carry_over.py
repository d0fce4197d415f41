import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.readings.carry_over import correct_carry_over, estimate_carry_over, reciprocity_error
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.sensor.patterns import adjacent_pattern

USABLE = adjacent_pattern(16).usable()
ORDER = np.arange(256)


def reciprocal_frames(count, seed, offset=0.0):
    """A symmetric frame that falls off with distance, as a sheet's does, with channels of their own size."""
    rng = np.random.default_rng(seed)
    away = np.abs(np.subtract.outer(np.arange(16), np.arange(16)))
    shape = -200.0 * np.exp(-np.minimum(away, 16 - away) / 1.2)
    shape *= np.exp(0.2 * rng.normal(size=16))[:, None] * np.exp(0.2 * rng.normal(size=16))[None]
    shape = (shape + shape.T) / 2
    np.fill_diagonal(shape, 600.0)
    return offset + shape + rng.normal(0, 1.0, (count, 16, 16))


def remembering(frames, share):
    stream, out = frames.ravel(), np.empty(frames.size)
    out[0] = stream[0]
    for k in range(1, len(stream)):
        out[k] = (1 - share) * stream[k] + share * out[k - 1]
    return out.reshape(frames.shape)


@given(st.floats(0.0, 0.45), st.floats(-1e4, 1e4), st.integers(0, 100))
def test_correction_inverts_the_memory_whatever_the_offset(share, offset, seed):
    frames = reciprocal_frames(3, seed, offset)
    np.testing.assert_allclose(correct_carry_over(remembering(frames, share), share, ORDER), frames, atol=1e-7)


def test_correction_follows_the_order_of_the_scan():
    frames = reciprocal_frames(3, 1)
    turned = remembering(frames.swapaxes(1, 2), 0.12).swapaxes(1, 2)
    order = np.arange(256).reshape(16, 16).T.ravel()
    np.testing.assert_allclose(correct_carry_over(turned, 0.12, order), frames, atol=1e-9)


def block(frames):
    return FrameBlock(np.arange(len(frames)) / 4, frames, np.zeros(frames.shape, np.uint8), VoltageUnit.COUNT, None)


@pytest.mark.parametrize("share", [0.05, 0.11, 0.14, 0.25])
def test_the_share_is_found_from_reciprocity_within_its_error(share):
    estimates = [
        estimate_carry_over(block(remembering(reciprocal_frames(60, seed, 99.0), share)), USABLE)
        for seed in range(12)
    ]
    assert all(e.worth_correcting for e in estimates)
    pull = [(e.share - share) / e.stderr for e in estimates]
    assert abs(np.mean([e.share for e in estimates]) - share) < 0.01
    assert np.sqrt(np.mean(np.square(pull))) < 4  # the model is a regression: its error is a guide, not exact
    assert all(e.error_corrected < 0.5 * e.error for e in estimates)


def test_frames_without_memory_are_left_alone():
    for seed in range(20):
        assert not estimate_carry_over(block(reciprocal_frames(60, seed, 99.0)), USABLE).worth_correcting


def test_unrelated_numbers_are_not_reciprocal():
    frame = np.random.default_rng(1).normal(size=(16, 16))
    assert reciprocity_error(frame, USABLE, 0.0) == pytest.approx(np.sqrt(2), rel=0.15)
    assert reciprocity_error(frame + frame.T, USABLE, 0.0) == 0
    assert reciprocity_error(np.zeros((16, 16)), USABLE, 0.0) is None
