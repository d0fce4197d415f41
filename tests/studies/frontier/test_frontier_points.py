"""Points of the frontier: what a document keeps of them, and which ones are worth their time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError, StoreError
from cbsr_qa.report.document import json_document
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis, restore
from cbsr_qa.studies.frontier.worth import mark_worth

numbers = st.floats(-1e6, 1e6)
figures = st.builds(
    Accuracy,
    numbers,
    st.none() | st.floats(0, 1e6),
    st.sampled_from(["mm", "%", "1"]),
    st.sampled_from(["more", "less"]),
    st.lists(numbers, max_size=3).map(tuple),
)
points = st.builds(
    Point,
    st.sampled_from(list(TimeBasis)),
    st.text(max_size=5),
    st.dictionaries(
        st.text(max_size=5), st.text(max_size=5) | numbers | st.integers(-100, 100) | st.booleans(), max_size=3
    ),
    st.dictionaries(st.text(max_size=5), figures, max_size=3),
    st.none() | numbers,
    st.none() | numbers,
    st.integers(1, 9),
    st.text(max_size=5),
    st.dictionaries(st.text(max_size=5), numbers, max_size=2),
    st.none() | st.booleans(),
)
# Few different numbers, so that ties and dominance are common.
measured = st.lists(
    st.tuples(
        st.integers(0, 3),
        st.dictionaries(
            st.sampled_from("abc"), st.tuples(st.integers(0, 6), st.sampled_from([None, 0.0, 0.6, 1.1, 1.6]))
        ),
    ),
    max_size=10,
)


def _point(cost: float, figures: dict[str, tuple[float, float | None]], *, better: str = "less") -> Point:
    accuracy = {name: Accuracy(value, stderr, "mm", better) for name, (value, stderr) in figures.items()}
    return Point(TimeBasis.COMPUTER, "made up", {"cost": cost}, accuracy, float(cost), None, 1)


def _worth(points, *names):
    """Whether each of some points is worth its computing time."""
    return tuple(point.pareto for point in mark_worth(points, lambda point: point.compute_s, names))


@given(points)
def test_a_point_survives_its_document(point):
    assert restore(Point, json_document(point)) == point


def test_a_point_that_was_stored_before_it_was_compared_can_be_read():
    document = json_document(_point(1.0, {"E": (0.5, 0.1)}))
    del document["pareto"]
    assert restore(Point, document).pareto is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("clock", "sun"),
        ("seeds", 1.5),
        ("seeds", True),
        ("seeds", 0),
        ("compute_s", "fast"),
        ("accuracy", {"E": {"value": 1}}),
        ("accuracy", {"E": {"value": 1.0, "stderr": None, "unit": "1", "better": "less", "by_sensor": [math.nan]}}),
        ("knobs", {"a": None}),
        ("knobs", []),
        ("series", 3),
        ("costs", {"setup_s": math.nan}),
    ],
)
def test_a_damaged_document_is_refused(key, value):
    document = json_document(_point(1.0, {}))
    with pytest.raises(StoreError, match="stored Point"):
        restore(Point, {**document, key: value})
    with pytest.raises(StoreError, match=key):
        restore(Point, {name: kept for name, kept in document.items() if name != key})


@pytest.mark.parametrize(("value", "stderr"), [(math.nan, None), (1.0, math.inf), (1.0, -0.1), (math.inf, 0.1)])
def test_an_accuracy_is_finite_or_absent(value, stderr):
    with pytest.raises(NumericsError, match="not a finite number"):
        Accuracy(value, stderr, "mm")


@given(measured)
def test_within_errors_some_are_kept_and_each_other_has_a_reason_among_them(rows):
    tried = [_point(cost, figures) for cost, figures in rows]
    kept = _worth(tried)
    assert any(kept) == bool(tried)
    front = [point for point, on in zip(tried, kept, strict=True) if on]
    for point, on in zip(tried, kept, strict=True):
        assert on != any(_reason(one, point) for one in front)


def _reason(one: Point, point: Point) -> bool:
    """The rule in its own words, written a second time."""
    both = [(one.accuracy[name], figure) for name, figure in point.accuracy.items() if name in one.accuracy]
    if len(both) < len(point.accuracy):
        return False
    if one.compute_s < point.compute_s and all(
        a.value - b.value <= math.sqrt((a.stderr or 0) ** 2 + (b.stderr or 0) ** 2) for a, b in both
    ):
        return True
    no_worse = one.compute_s <= point.compute_s and all(a.value <= b.value for a, b in both)
    return no_worse and (one.compute_s < point.compute_s or any(a.value < b.value for a, b in both))


@given(measured, st.integers(0, 9))
def test_within_errors_a_dominated_setting_left_out_changes_nothing(rows, which):
    tried = [_point(cost, figures) for cost, figures in rows]
    kept = _worth(tried)
    if which < len(tried) and not kept[which]:
        fewer = tried[:which] + tried[which + 1 :]
        assert _worth(fewer) == kept[:which] + kept[which + 1 :]


@given(measured, st.randoms(use_true_random=False))
def test_the_order_of_settings_does_not_matter(rows, random):
    tried = [_point(cost, figures) for cost, figures in rows]
    order = random.sample(range(len(tried)), len(tried))
    kept = _worth(tried)
    assert _worth([tried[at] for at in order]) == tuple(kept[at] for at in order)


def test_a_dearer_setting_is_kept_only_where_it_is_better_by_more_than_chance():
    cheap, alike, better = (_point(cost, {"E": (value, 0.3)}) for cost, value in ((1, 1.0), (2, 0.7), (3, 0.5)))
    assert cheap.accuracy["E"].subtract(alike.accuracy["E"]).stderr == pytest.approx(0.3 * math.sqrt(2))
    assert _worth([cheap, alike, better]) == (True, False, True)


def test_more_is_better_where_a_figure_says_so():
    low, high = (_point(cost, {"A_OL": (value, 1.0)}, better="more") for cost, value in ((1, 60.0), (2, 90.0)))
    worse = _point(3, {"A_OL": (70.0, 1.0)}, better="more")
    assert _worth([low, high, worse]) == (True, True, False)


def test_only_the_accuracies_asked_for_count():
    one, other = _point(1, {"a": (1, None), "b": (5, None)}), _point(2, {"a": (1, None), "b": (1, None)})
    assert _worth([one, other]) == (True, True)
    assert _worth([one, other], "a") == (True, False)


def test_a_setting_without_a_cost_or_an_accuracy_asked_for_is_not_worth_it():
    free = Point(TimeBasis.COMPUTER, "x", {}, {"a": Accuracy(0.0, None, "mm")})
    other = _point(2, {"a": (1, None)})
    assert _worth([free, other, _point(1, {"b": (0, None)})], "a") == (False, True, False)


@pytest.mark.parametrize("across_series", [False, True])
def test_settings_are_compared_within_their_series_unless_asked_otherwise(across_series):
    cheap, dear = _point(1, {"a": (1, None)}), replace(_point(2, {"a": (2, None)}), series="another")
    found = mark_worth([cheap, dear], lambda point: point.compute_s, across_series=across_series)
    assert [point.pareto for point in found] == [True, not across_series]


def test_settings_tried_on_the_same_sensors_are_compared_in_pairs():
    """Sensors differ by much more than the two settings do on each of them."""
    sensors = np.array([1.0, 2.0, 3.0, 6.0])
    cheap, better = (Accuracy.from_sensors(values, "N") for values in (sensors, sensors - [0.1, 0.11, 0.09, 0.1]))
    assert better.subtract(cheap).stderr == pytest.approx(np.std([0.1, 0.11, 0.09, 0.1], ddof=1) / 2)
    assert better.subtract(cheap).stderr < 0.01 < 0.5 < math.hypot(cheap.stderr, better.stderr)
    points = [replace(_point(cost, {}), accuracy={"E": value}) for cost, value in ((1, cheap), (2, better))]
    assert _worth(points) == (True, True)
    others = [replace(point, accuracy={"E": replace(point.accuracy["E"], by_sensor=())}) for point in points]
    assert _worth(others) == (True, False)


def test_a_difference_to_a_multiple_is_of_pairs_too():
    one, other = Accuracy.from_sensors([1.0, 2.0, 4.0], "N"), Accuracy.from_sensors([2.0, 4.0, 8.0], "N")
    assert (one.subtract(other, 0.5).value, one.subtract(other, 0.5).stderr) == (0.0, 0.0)
    unpaired = one.subtract(Accuracy(2.0, 0.3, "N"), 2.0)
    assert (unpaired.value, unpaired.stderr) == pytest.approx((7 / 3 - 4, math.hypot(one.stderr, 0.6)))


def test_an_upper_bound_holds_as_often_as_it_says():
    random = np.random.default_rng(3)
    bounds = [Accuracy.from_sensors(1 + random.standard_normal(4), "N").upper_bound(0.9) for _ in range(2000)]
    assert np.mean(np.array(bounds) >= 1) == pytest.approx(0.9, abs=0.02)
    assert Accuracy(1.0, 0.1, "N").upper_bound(0.95) == pytest.approx(1.1645, abs=1e-4)
    assert Accuracy(1.0, None, "N").upper_bound(0.95) == 1.0  # exact
    assert Accuracy.from_sensors([1.0], "N").upper_bound(0.95) is None
