"""Ordered differences of two groups by counting, against all of them made and sorted."""

import numpy as np
import pytest

from cbsr_qa.stats import robust as pairwise


def groups(kind, sizes):
    random = np.random.default_rng(len(kind))
    x, y = (random.standard_normal(size) for size in sizes)
    match kind:
        case "tied":
            return np.round(x, 1), np.round(y, 1)
        case "all alike":
            return np.full(sizes[0], 2.0), np.full(sizes[1], 3.0)
        case "far from zero":
            return x + 1e8, 1e-3 * y
        case "of many sizes":
            return np.exp(3 * x), np.exp(3 * y)
        case "one outlier":
            return np.append(x[1:], 1e12), y
    return x, y


@pytest.mark.parametrize("kind", ["normal", "tied", "all alike", "far from zero", "of many sizes", "one outlier"])
@pytest.mark.parametrize("sizes", [(60, 45), (7, 300), (300, 1)])
def test_every_rank_is_found_without_making_all_of_them(kind, sizes, monkeypatch):
    monkeypatch.setattr(pairwise, "_MOST_MADE", 0)
    monkeypatch.setattr(pairwise, "_FEW_MADE", 20)
    x, y = groups(kind, sizes)
    every = np.sort(np.subtract.outer(x, y).ravel())
    ranks = [1, 2, len(every) // 3, len(every) // 2, len(every) - 1, len(every)]
    found = pairwise.differences_of_rank(x, y, ranks)
    # Counting rounds y + value once: to the spacing of doubles of the largest of them.
    rounding = 2 * np.spacing(max(np.abs(x).max(), np.abs(y).max(), np.abs(every).max()))
    np.testing.assert_allclose(found, every[np.array(ranks) - 1], rtol=0, atol=rounding)


def test_groups_of_thousands_are_counted():
    x, y = groups("normal", (1700, 1300))
    every = np.sort(np.subtract.outer(x, y).ravel())
    ranks = [1, 1000, len(every) // 2, len(every)]
    assert len(every) > pairwise._MOST_MADE
    assert pairwise.differences_of_rank(x, y, ranks) == pytest.approx(every[np.array(ranks) - 1], abs=1e-14)
