"""Blocks of frames survive storage to the last bit, and any change to them is found."""

import zlib

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.readings.frames import LARGEST_VALUE, FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.store.runs.codec import frame_block, frame_values, sample_block, sample_values
from cbsr_qa.store.tables.runs import FrameBlockRow, SampleBlockRow
from cbsr_qa.store.types import compact, restore

FINITE = st.floats(-LARGEST_VALUE, LARGEST_VALUE)
KEY = {"run": "r", "phase": 0, "block": 0}


@st.composite
def frame_blocks(draw):
    frames, drives, measures = draw(st.integers(1, 3)), draw(st.integers(1, 4)), draw(st.integers(1, 4))
    shape = frames, drives, measures
    return FrameBlock(
        draw(hnp.arrays(np.float64, frames, elements=st.floats(-1e9, 1e9))),
        # Big-endian and column-major arrays hold the same numbers and must come back the same.
        np.asfortranarray(draw(hnp.arrays(draw(st.sampled_from(["<f8", ">f8"])), shape, elements=FINITE))),
        draw(hnp.arrays(np.uint8, shape)),
        draw(st.sampled_from(VoltageUnit)),
        draw(st.none() | st.floats(1e-9, 1.0)),
        draw(st.none() | hnp.arrays(np.float64, shape, elements=FINITE)),
    )


@given(frame_blocks())
def test_frames_survive_to_the_last_bit(block):
    back = frame_block(FrameBlockRow(**KEY, **frame_values(block)))
    assert (back.unit, back.current_A) == (block.unit, block.current_A)
    for name in ("time_s", "voltages", "flags", "reading_time_s"):
        stored, told = getattr(back, name), getattr(block, name)
        if told is None:
            assert stored is None
        else:
            assert stored.tobytes() == np.ascontiguousarray(told, dtype=stored.dtype).tobytes(), name


@given(frame_blocks(), st.data())
def test_any_changed_bit_is_found_or_changes_nothing_that_was_measured(block, data):
    values = frame_values(block)
    name = data.draw(st.sampled_from([n for n, v in values.items() if isinstance(v, bytes)]))
    spoilt = bytearray(values[name])
    place = data.draw(st.integers(0, len(spoilt) - 1))
    spoilt[place] ^= 1 << data.draw(st.integers(0, 7))
    try:
        back = frame_block(FrameBlockRow(**KEY, **(values | {name: bytes(spoilt)})))
    except StoreError:
        return
    # Only padding after the end of what is deflated may change.
    kind = np.uint8 if name == "flags" else np.float64
    assert getattr(back, name).tobytes() == np.ascontiguousarray(getattr(block, name), kind).tobytes()


@given(st.binary(max_size=400), st.sampled_from([1, 8]), st.booleans())
@example(bytes([1, 0, 0, 0, 0, 0]), 1, True)
def test_any_bits_survive_being_compact(data, width, steps):
    data = data[: len(data) // width * width]
    stored = compact(data, width, steps=steps)
    assert len(stored) <= len(data)
    assert restore(stored, len(data), width, steps=steps) == data


@pytest.mark.parametrize("start_s", [297.5, 1023.9, 30000.0])
def test_times_of_readings_take_an_eighth_of_their_bytes(start_s):
    ticks = np.round((start_s + 0.0097207 * np.arange(256.0)) * 2.0**20) / 2.0**20
    turned = np.concatenate([np.roll(row, k) for k, row in enumerate(ticks.reshape(16, 16))]).astype("<f8").tobytes()
    stored = compact(turned, 8, steps=True)
    assert len(stored) < len(turned) / 8
    assert restore(stored, len(turned), 8, steps=True) == turned


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: zlib.compress(bytes(2**24), wbits=-15),
        lambda data: zlib.compress(bytes(8), wbits=-15),
        lambda data: b"",
    ],
)
def test_what_does_not_hold_the_numbers_is_refused(spoil):
    data = bytes(2048)
    with pytest.raises(ValueError, match=r"do not hold 2048|Error -"):
        restore(spoil(compact(data, 8)), len(data), 8)


def test_bytes_moved_from_one_array_to_the_next_are_found():
    block = FrameBlock(np.zeros(1), np.zeros((1, 2, 2)), np.zeros((1, 2, 2), np.uint8), VoltageUnit.VOLT, None)
    values = frame_values(block)
    moved = {"time_s": values["time_s"][:-1], "voltages": values["time_s"][-1:] + values["voltages"]}
    with pytest.raises(StoreError):
        frame_block(FrameBlockRow(**KEY, **(values | moved)))


@given(hnp.arrays(np.float64, st.integers(0, 20), elements=FINITE))
def test_samples_survive_to_the_last_bit(values):
    block = SampleBlock("force", "N", np.arange(len(values), dtype=float), values)
    row = SampleBlockRow(**KEY, **sample_values(block))
    assert sample_block(row).values.tobytes() == values.tobytes()
    row.unit = "mN"
    with pytest.raises(StoreError):
        sample_block(row)
