"""Many blocks are checked as each is, and COPY brings every type of cell."""

import random
from datetime import UTC, datetime
from types import SimpleNamespace

import numpy as np
import pytest
import sqlalchemy as sa
from synced import opened

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.store.engine import writing
from cbsr_qa.store.runs.codec import frame_values, sample_values
from cbsr_qa.store.runs.many_blocks import check_many_frames, check_many_samples
from cbsr_qa.store.sync import copying
from cbsr_qa.store.types import Digest, FiniteDouble, Instant, PlainText, Whole, Word, restore, restore_many


def frames(number, *, timed=True, current_A=None):
    source = np.random.default_rng(number)
    voltages = source.normal(size=(2, 3, 4))
    times = voltages.cumsum().reshape(voltages.shape) if timed else None
    block = FrameBlock(np.array([1.0, 1.5]) + number, voltages, source.integers(0, 2, (2, 3, 4)).astype(np.uint8),
                       VoltageUnit.VOLT, current_A, times)  # fmt: skip
    return as_stored(frame_values(block), number)


def samples(number):
    return as_stored(sample_values(SampleBlock("force", "N", np.arange(9.0), np.full(9, number))), number)


def as_stored(values, number):
    return SimpleNamespace(run="r", phase=0, block=number, **(values | {"sha256": bytes.fromhex(values["sha256"])}))


def blocks():
    kinds = [{}, {"timed": False}, {"current_A": 1e-4}]
    return [frames(number, **kinds[number % 3]) for number in range(12)]


def test_blocks_that_match_their_digests_are_accepted():
    check_many_frames(blocks())
    check_many_samples([samples(number) for number in range(5)])


@pytest.mark.parametrize("column", ["time_s", "voltages", "flags", "reading_time_s", "sha256"])
@pytest.mark.parametrize("spoilt", [lambda data: data[:-1], lambda data: bytes(len(data)), lambda data: data + b"x"])
def test_the_block_that_was_changed_is_named(column, spoilt):
    rows = blocks()
    setattr(rows[6], column, spoilt(getattr(rows[6], column)))
    with pytest.raises(StoreError, match="frame block 6 of phase 0 of run r"):
        check_many_frames(rows)


def test_the_samples_that_were_changed_are_named():
    rows = [samples(number) for number in range(5)]
    rows[3].unit = "kN"
    with pytest.raises(StoreError, match="sample block 3"):
        check_many_samples(rows)


@pytest.mark.parametrize("steps", [True, False])
def test_cells_are_restored_together_as_one_by_one(steps):
    stored = [frames(number).reading_time_s for number in range(300)]
    stored[7] = random.Random(7).randbytes(192)
    assert restore_many(stored, 192, 8, steps=steps) == [restore(one, 192, 8, steps=steps) for one in stored]


#: A cell of each type of column.
CELLS = [
    (FiniteDouble(), -1.5e-300),
    (Whole(), -(2**31)),
    (Instant(), datetime(1987, 6, 5, 4, 3, 2, 1, tzinfo=UTC)),
    (sa.Boolean(), True),
    (sa.JSON(), {"a": [1, "α"]}),
    (sa.LargeBinary(), bytes(range(256))),
    (Digest(), bytes(range(32))),
    (PlainText(), "α\n"),
    (Word(9), "volt"),
]


def table_of_each_type():
    return sa.Table("each", sa.MetaData(), *(sa.Column(f"c{n}", kind) for n, (kind, _) in enumerate(CELLS)))


@pytest.mark.postgres
def test_every_type_arrives_by_copy_and_empty_cells_stay_empty(postgres_database):
    engine, table = opened(postgres_database), table_of_each_type()
    full = tuple(cell for _, cell in CELLS)
    rows = [*[full] * 300, *[(*full[:n], None, *full[n + 1 :]) for n in range(len(full))]]
    with writing(engine) as connection:
        table.create(connection)
        copying.copy_rows(connection, table, rows)
        read = [tuple(row) for row in connection.execute(sa.select(table))]
    engine.dispose()
    digest = 6
    assert read == [(*row[:digest], row[digest] and row[digest].hex(), *row[digest + 1 :]) for row in rows]


@pytest.mark.parametrize("place", range(len(CELLS)))
def test_a_cell_that_does_not_fit_its_column_is_named(place):
    row = [cell for _, cell in CELLS]
    row[place] = {1: 2**31, 4: {1j}}.get(place, row)
    if place != 3:  # everything is true or false
        with pytest.raises(OverflowError, match=f"each.c{place}"):
            copying.encode_rows(table_of_each_type(), [row] * 5)
