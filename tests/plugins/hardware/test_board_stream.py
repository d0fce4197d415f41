"""The ERT board's bytes, taken apart: where frames begin, what is lost, what is no frame."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa_plugins.hardware._board_stream import BinaryStream, TextStream, binary_frame_bytes, stream_order

BINARY_FRAME = binary_frame_bytes(16)
FRAMES = np.random.default_rng(20).integers(0, 2**16, (6, 16, 16))


def binary(counts):
    """What the board sends for a frame; written as the firmware prints it."""
    sent = b"".join(int(count).to_bytes(2, "little") + b"\r" for count in np.ravel(counts))
    return sent + b"A\r"


def text(counts, *, first_ms=None):
    rows = []
    for number, row in enumerate(counts):
        clock = "" if first_ms is None else f"{first_ms + 15 * number},"
        rows.append(clock + "".join(f"{count}," for count in row))
    return ("A\n" + "".join(f"{row}\n" for row in rows)).encode()


END = b"A\n"  # text is whole with the next mark


def fed(stream, data, size):
    return [frame for k in range(0, len(data), size) for frame in stream.feed(data[k : k + size])]


@pytest.mark.parametrize("size", [1, 7, 48, 770, 10_000])
def test_binary_frames_come_whole_whatever_the_pieces(size):
    data = b"".join(binary(counts) for counts in FRAMES)
    assert len(data) == len(FRAMES) * BINARY_FRAME
    frames = fed(BinaryStream(16), data, size)
    np.testing.assert_array_equal([frame.counts for frame in frames], FRAMES)
    assert not any(frame.after_loss for frame in frames)


@pytest.mark.parametrize("size", [1000, 3074])
def test_frames_of_a_board_of_32_pairs_come_whole(size):
    counts = np.random.default_rng(21).integers(0, 2**16, (5, 32, 32))
    sent = b"".join(map(binary, counts))
    np.testing.assert_array_equal([frame.counts for frame in fed(BinaryStream(32), sent, size)], counts)
    said = b"".join(map(text, counts)) + END
    np.testing.assert_array_equal([frame.counts for frame in fed(TextStream(32, 0, 65_535), said, size)], counts)


def test_frames_of_another_board_are_none():
    counts = np.random.default_rng(22).integers(0, 2**16, (5, 16, 16))
    assert not fed(BinaryStream(32), b"".join(map(binary, counts)), 1000)
    assert not fed(TextStream(32, 0, 65_535), b"".join(map(text, counts)) + END, 1000)


@drawn(40)
@given(
    cut=st.integers(0, BINARY_FRAME - 1),
    counts=st.lists(st.sampled_from([0x0D0D, 0x410D, 0x0D41, 0x4141, 0, 0xFFFF, 30_000]), min_size=256, max_size=256),
)
def test_a_stream_joined_anywhere_is_cut_at_its_true_marks(cut, counts):
    """Counts made of the separators' own bytes; the first and the last are not, or it could not be told at all."""
    frame = np.array([30_000, *counts[1:-1], 30_000]).reshape(16, 16)
    found = fed(BinaryStream(16), (4 * binary(frame))[cut:], 481)
    assert len(found) >= 2
    for one in found:
        np.testing.assert_array_equal(one.counts, frame)


@pytest.mark.parametrize("cut", [0, 1, 2, 3, 4, 768])
@pytest.mark.parametrize(("reading", "count"), [(0, 0x410D), (255, 0x0D41)])
def test_a_count_that_looks_like_the_mark_is_told_by_the_frame_in_which_it_changes(cut, reading, count):
    """The first count as 0x410D fits one reading late as well; the last as 0x0D41 one early."""
    frames = np.tile(FRAMES[0], (5, 1, 1))
    frames.reshape(5, 256)[:, reading] = [count, count, count, count + 1, count]
    stream = BinaryStream(16)
    found = stream.feed(b"".join(binary(one) for one in frames)[cut:])
    assert len(found) >= 4
    for one, sent in zip(reversed(found), reversed(frames), strict=False):
        np.testing.assert_array_equal(one.counts, sent)
    assert not any(one.after_loss for one in found)


@pytest.mark.parametrize("spoilt_at", [0, 2, 5, 401, 767, 768, 769])
def test_a_byte_lost_on_the_way_costs_its_frame_and_is_noticed(spoilt_at):
    data = b"".join(binary(counts) for counts in FRAMES[:4])
    at = BINARY_FRAME + spoilt_at
    stream = BinaryStream(16)
    frames = fed(stream, data[:at] + data[at + 1 :], 48)
    np.testing.assert_array_equal([frame.counts for frame in frames], FRAMES[[0, 2, 3]])
    assert [frame.after_loss for frame in frames] == [False, True, False]


def test_a_changed_separator_is_noticed_and_the_next_frames_are_whole():
    data = bytearray(b"".join(binary(counts) for counts in FRAMES[:3]))
    data[BINARY_FRAME + 2] ^= 0x15
    frames = BinaryStream(16).feed(bytes(data))
    np.testing.assert_array_equal([frame.counts for frame in frames], FRAMES[[0, 2]])


def test_after_a_restart_the_rest_of_a_frame_is_no_loss():
    data = b"".join(binary(counts) for counts in FRAMES[:3])
    stream = BinaryStream(16)
    stream.feed(data[:900])
    stream.restart()
    (frame,) = stream.feed(data[1000:])
    np.testing.assert_array_equal(frame.counts, FRAMES[2])
    assert not frame.after_loss


def test_what_is_no_board_gives_no_frame_and_does_not_pile_up():
    stream = BinaryStream(16)
    for _ in range(50):
        assert stream.feed(b"T:25.0 /0.0 ok\r\n" * 100) == []
    assert len(stream._buffer) < 2 * BINARY_FRAME
    words = TextStream(16, 0, 65_535)
    assert fed(words, b"x" * 100_000, 4096) == []
    assert len(words._buffer) <= 4096


@pytest.mark.parametrize("first_ms", [None, 4242])
@pytest.mark.parametrize("size", [1, 64, 100_000])
def test_text_frames_come_whole_with_or_without_the_boards_clock(first_ms, size):
    data = b"1,2,3,\n" + b"".join(text(counts, first_ms=first_ms) for counts in FRAMES)
    frames = fed(TextStream(16, 0, 65_535), data + END, size)
    np.testing.assert_array_equal([frame.counts for frame in frames], FRAMES)
    assert not any(frame.after_loss for frame in frames)


def test_signed_text_is_read_with_its_sign():
    counts = FRAMES[0] - 2**15
    (frame,) = TextStream(16, -(2**15), 2**15 - 1).feed(text(counts) + END)
    np.testing.assert_array_equal(frame.counts, counts)


def test_logs_between_rows_are_left_out():
    whole = text(FRAMES[0]).split(b"\n")
    dump = [b"\x1b[0;31mE (42) task_wdt: Task watchdog got triggered.\x1b[0m", b"", b"Backtrace: 0x1:0x2 0x3:0x4"]
    (frame,) = TextStream(16, 0, 65_535).feed(b"\n".join([*whole[:8], *dump, *whole[8:]]) + END)
    np.testing.assert_array_equal(frame.counts, FRAMES[0])


SPOILT = {
    "no comma at its end": lambda row: row[:-1],
    "a count short": lambda row: row.split(b",", 1)[1],
    "joined with another": lambda row: row + row,
    "no count of 16 bits": lambda row: b"70000," + row.split(b",", 1)[1],
    "a gap": lambda row: row.replace(b",", b",,", 1),
    "missing": lambda row: b"",
    "twice": lambda row: row + b"\n" + row,
}


@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
def test_a_spoilt_row_costs_its_frame_and_is_noticed(spoil):
    lines = text(FRAMES[1]).split(b"\n")
    lines[5] = spoil(lines[5])
    stream = TextStream(16, 0, 65_535)
    frames = stream.feed(text(FRAMES[0]) + b"\n".join(lines) + text(FRAMES[2]) + text(FRAMES[3]) + END)
    np.testing.assert_array_equal([frame.counts for frame in frames], FRAMES[[0, 2, 3]])
    assert [frame.after_loss for frame in frames] == [False, True, False]


def test_the_order_of_a_stream_says_where_each_reading_belongs():
    """The lab's start-up query steps once, so that a scan may begin with its second reading."""
    frame = np.arange(256).reshape(16, 16)
    for order, sent in (("measure", frame), ("drive", frame.T)):
        for first in (0, 1, 255):
            stream = np.roll(sent.ravel(), -first)
            back = np.empty(256, dtype=int)
            back[stream_order(16, order, first)] = stream
            np.testing.assert_array_equal(back.reshape(16, 16), frame)
