"""Random numbers are addressed: order, neighbours, processes and cores change none of them."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.simulate.streams import RandomStream

INDEX = st.integers(0, 2**64 - 1)
SEED = st.integers(-(2**70), 2**70)


@given(seed=SEED, indices=st.lists(INDEX, min_size=1, max_size=8, unique=True), data=st.data())
def test_the_order_of_drawing_changes_nothing(seed: int, indices: list[int], data: st.DataObject):
    shuffled = data.draw(st.permutations(indices))
    one, other = RandomStream(seed, "noise"), RandomStream(seed, "noise")
    first = {index: one.normal(index, (3,)) for index in indices}
    other.normal(shuffled[-1], (5,))
    second = {index: other.normal(index, (3,)) for index in shuffled}
    for index in indices:
        np.testing.assert_array_equal(first[index], second[index])


@given(seed=SEED, index=INDEX)
def test_a_draw_equals_that_of_a_generator_put_there(seed: int, index: int):
    stream = RandomStream(seed, "noise")
    np.testing.assert_array_equal(stream.normal(index, (2, 3)), stream.generator(index).standard_normal((2, 3)))


def test_generators_of_two_indices_do_not_share_their_state():
    stream = RandomStream(1, "noise")
    here, there = stream.generator(1), stream.generator(2)
    mixed = [here.standard_normal(), there.standard_normal(), here.standard_normal()]
    assert mixed[0::2] == list(stream.normal(1, (2,)))
    assert mixed[1] == stream.normal(2)


def test_a_longer_draw_begins_with_the_shorter_one():
    stream = RandomStream(5, "noise")
    np.testing.assert_array_equal(stream.normal(9, (100,))[:10], stream.normal(9, (10,)))


def test_seed_name_and_index_each_give_other_numbers():
    draws = [
        RandomStream(seed, name).normal(index, (4,))
        for seed in (0, 1, -1)
        for name in ("a", "b", "ab")
        for index in range(9)
    ]
    assert len({draw.tobytes() for draw in draws}) == len(draws)


def test_seed_and_name_cannot_be_mistaken_for_each_other():
    assert RandomStream(1, "1x").normal(0) != RandomStream(11, "x").normal(0)


def test_neighbouring_indices_are_uncorrelated_and_normal():
    stream = RandomStream(3, "noise")
    draws = np.stack([stream.normal(index, (16,)) for index in range(4000)])
    flat, count = draws.ravel(), draws.size
    assert abs(flat.mean()) < 5 / np.sqrt(count)
    assert abs(flat.var() - 1) < 5 * np.sqrt(2 / count)
    assert abs((draws[1:] * draws[:-1]).mean()) < 5 / np.sqrt(count)
    assert abs((draws[:, 1:] * draws[:, :-1]).mean()) < 5 / np.sqrt(count)


def test_any_number_of_threads_gives_the_same_numbers():
    def block(indices: range) -> np.ndarray:
        stream = RandomStream(7, "noise")
        return np.stack([stream.normal(index, (8,)) for index in indices])

    alone = block(range(60))
    with ThreadPoolExecutor(3) as pool:
        shared = np.concatenate(list(pool.map(block, (range(0, 20), range(20, 40), range(40, 60)))))
    np.testing.assert_array_equal(alone, shared)


def test_another_process_gives_the_same_numbers():
    code = (
        "from cbsr_qa.simulate.streams import RandomStream\n"
        "print(RandomStream(7, 'noise').normal(3, (4,)).tobytes().hex())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == RandomStream(7, "noise").normal(3, (4,)).tobytes().hex()


@pytest.mark.parametrize("index", [-1, 2**64])
def test_an_index_out_of_range_is_refused(index: int):
    with pytest.raises(RefusedError, match="index is"):
        RandomStream(1, "noise").normal(index)
