"""The computer's clock: errors against truth fall as they should, whatever the time was."""

import pickle
import re
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, ParameterChoice, linear
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.report.document import json_document
from cbsr_qa.studies.frontier.computer import forward as computer_forward, imaging as computer_imaging
from cbsr_qa.studies.frontier.computer.forward import fastest_s, measure_forward, time_call
from cbsr_qa.studies.frontier.computer.imaging import (
    RECIPES_METHOD,
    MethodSetting,
    make_imager,
    make_method,
    measure_mesh,
    measure_method,
    measure_precision,
    relative_error,
)
from cbsr_qa.studies.frontier.computer.readings import base_scene_readings, figures_of_merit, sensor_changes
from cbsr_qa.studies.frontier.computer.sweeps import mark_worth_of_computer, plan_computer_work
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis, restore
from cbsr_qa.studies.frontier.station import (
    list_choices_of_even,
    list_parts_of_even,
    list_parts_of_paper,
    list_simulated_ways,
)
from cbsr_qa.testing.numerics import assert_expected_order


@pytest.fixture(autouse=True)
def _untimed(monkeypatch):
    """Run once what the sweeps repeat for its time."""

    def once(run, repeats=1):
        run()
        return 1e-3

    for module in (computer_forward, computer_imaging):
        monkeypatch.setattr(module, "fastest_s", once)


# --- forward model ---------------------------------------------------------------------------------------


@lru_cache(maxsize=16)
def forward(electrodes, order, size):
    return measure_forward(electrodes, order, size)


# Meshes this coarse do not reach the full orders yet; see the tests of the forward model for those.
@pytest.mark.rest
@pytest.mark.parametrize(
    ("electrodes", "order", "sizes", "expected"),
    [
        ("arc", 2, (10.0, 6.75, 4.5), {"voltage_error": 3.3}),
        ("pin", 1, (4.0, 2.8, 2.0), {"voltage_error": 1.6, "load_signal_error": 1.7}),
        ("pin", 2, (10.0, 7.5, 5.5), {"voltage_error": 2.6, "load_signal_error": 1.9}),
    ],
)
def test_errors_fall_with_the_mesh_and_unknowns_are_what_they_cost(electrodes, order, sizes, expected):
    points = [forward(electrodes, order, size) for size in sizes]
    for name, rate in expected.items():
        assert_expected_order([point.accuracy[name].value for point in points], sizes, rate)
    for cost in ("unknowns", "memory_bytes"):
        coarse, middle, fine = (point.costs[cost] for point in points)
        assert coarse < middle < fine
    # Factors of a plane mesh grow faster than its unknowns (George 1973: n log n).
    per_unknown = [point.costs["memory_bytes"] / point.costs["unknowns"] for point in points]
    assert per_unknown[0] < per_unknown[2]


@pytest.mark.rest
def test_second_order_is_the_better_buy_of_unknowns():
    first, second = forward("pin", 1, 2.0), forward("pin", 2, 7.5)
    assert second.costs["unknowns"] < 1.5 * first.costs["unknowns"]
    assert second.accuracy["voltage_error"].value < first.accuracy["voltage_error"].value / 5


# --- figures of merit ------------------------------------------------------------------------------------


@dataclass
class _Painted:
    """Images with a known blob, whatever the readings: where the head was, moved; nothing where none pressed."""

    choice: ClassVar = ParameterChoice(1.0, "given", 1.0)

    problem: ImagingProblem
    shift_mm: float
    readings: object
    method: str = "painted"

    def images(self, changes):
        return np.array([self._image(change) for change in changes])

    def _image(self, change):
        for number in range(len(self.readings.loaded)):
            _, loaded = sensor_changes(self.readings, number, self)
            pressed = np.flatnonzero(np.abs(loaded - change).max(axis=1) == 0)
            if pressed.size:
                x_mm, y_mm = self.readings.heads[pressed[0]].centre_mm
                away = np.hypot(*(self.problem.mesh.centroids_mm - [x_mm + self.shift_mm, y_mm]).T)
                return 1 - 0.15 * (away / 6.5) ** 2  # reaches 85 % of its maximum on the head's outline
        return np.zeros(len(self.problem.mesh.elements))


@pytest.fixture(scope="module")
def fine_problem():
    return imaging_problem(base_scene_readings(2).sensor_type, image_size_mm=2.5)


@pytest.mark.parametrize(
    ("shift_mm", "error", "overlap", "deviation"), [(0.0, 0.0, 100.0, 0.0), (2.0, 2.0, 80.49, 1.99)]
)
def test_figures_of_a_known_image_are_the_known_ones(fine_problem, shift_mm, error, overlap, deviation):
    readings = base_scene_readings(2)
    figures = figures_of_merit(_Painted(fine_problem, shift_mm, readings), readings)
    assert figures["E_CoM"].value == pytest.approx(error, abs=0.02)
    assert figures["A_OL"].value == pytest.approx(overlap, abs=2)  # a polygon inside a circle
    assert figures["SD"].value == pytest.approx(deviation, abs=0.05)
    assert figures["A_OL"].better == "more"
    assert figures["missed"].value == 0
    assert all(figure.stderr == pytest.approx(0, abs=1e-12) for figure in figures.values())


def test_images_without_a_blob_are_missed_and_have_no_other_figure(fine_problem):
    readings = base_scene_readings(2)
    blind = LinearReconstruction(
        "blind", fine_problem, np.zeros(fine_problem.jacobian.T.shape), ParameterChoice(0.0, "given", 1.0)
    )
    assert figures_of_merit(blind, readings) == {"missed": Accuracy.from_sensors([1.0, 1.0], "1")}


def test_one_sensor_has_no_standard_error():
    point = measure_method(RECIPES_METHOD, 1.0, 1)
    assert point.accuracy
    assert all(figure.stderr is None for figure in point.accuracy.values())


# --- readings --------------------------------------------------------------------------------------------


def test_readings_are_of_the_nine_places_with_the_noise_of_the_material():
    readings = base_scene_readings(3)
    sensor, head = readings.sensor_type, readings.heads[0]
    assert readings.loaded.shape == (3, 9, *sensor.pattern.shape)
    assert head.centre_mm == (0.0, 0.0)
    noise = readings.unloaded[:, :, sensor.pattern.usable()].std(axis=(0, 1), ddof=1)
    level = np.abs(readings.unloaded[0, 0][sensor.pattern.usable()]).mean()
    stated = 7.9e-4  # of the material 8 wt%
    assert np.sqrt((noise**2).mean()) / level == pytest.approx(stated, rel=0.05)


def test_no_seed_is_refused():
    with pytest.raises(ConfigError, match="0 seeds"):
        base_scene_readings(0)


@pytest.mark.rest
def test_more_sensors_make_smaller_standard_errors():
    few, many = (measure_method(RECIPES_METHOD, 1.0, seeds).accuracy["A_OL"].stderr for seeds in (3, 12))
    assert many < few


# --- reconstruction and mesh of the image ----------------------------------------------------------------


@pytest.mark.rest
def test_an_image_mesh_that_does_not_resolve_the_head_costs_overlap():
    coarse, fine = measure_mesh(RECIPES_METHOD, 8.0, 4), measure_mesh(RECIPES_METHOD, 4.0, 4)
    assert coarse.costs["unknowns"] < fine.costs["unknowns"]
    lost = fine.accuracy["A_OL"].value - coarse.accuracy["A_OL"].value
    assert lost > 3 * np.hypot(fine.accuracy["A_OL"].stderr, coarse.accuracy["A_OL"].stderr)


def test_less_smoothing_than_noise_allows_costs_overlap_and_ends_in_missed_loads():
    own, less, least = (measure_method(RECIPES_METHOD, factor, 3) for factor in (1.0, 0.3, 0.03))
    assert own.accuracy["missed"].value == 0
    assert less.accuracy["A_OL"].value < own.accuracy["A_OL"].value - 5
    assert least.accuracy["missed"].value > 0


def test_a_setting_that_is_refused_is_a_point_that_says_why():
    point = measure_method(MethodSetting("gauss-newton-noser", (("noise_figure", 1e9),)), 1.0, 1)
    assert point.accuracy == {}
    assert point.compute_s is None
    assert "cannot be reached" in point.note
    assert not mark_worth_of_computer([point])[0].pareto


def test_a_count_that_would_part_a_pair_takes_the_next():
    point = measure_method(MethodSetting("truncated-svd", (), "components"), 0.5, 1)
    own = measure_method(MethodSetting("truncated-svd", (), "components"), 1.0, 1)
    kept, of = (int(one.note.split(",")[0].rsplit(" ", 1)[1]) for one in (point, own))
    assert of / 2 - 1 <= kept <= of / 2 + 1
    assert point.accuracy


def test_the_method_of_the_recipes_is_the_one_that_is_looked_at():
    chosen = load_recipe("campaign").value.reconstruction
    assert (chosen.name, dict(chosen.options)) == (RECIPES_METHOD.name, dict(RECIPES_METHOD.options))


def test_every_method_of_single_frames_is_tried_and_no_other():
    names = {method.name for method in computer_imaging.list_methods()}
    assert {"gauss-newton-noser", "greit", "truncated-svd", "linear-back-projection", "total-variation"} <= names
    assert not {"temporal", "absolute-gauss-newton"} & names
    smoothing = {method.name: method.smoothing for method in computer_imaging.list_methods()}
    assert smoothing["truncated-svd"] == "components"
    assert smoothing["gauss-newton-laplace"] == "hyperparameter"
    assert smoothing["linear-back-projection"] == smoothing["total-variation"] == ""


# --- applying the matrix ---------------------------------------------------------------------------------


def error_bound(matrix, changes, precision):
    """Bound of :func:`relative_error`, whatever the order of summation (Higham 2002, section 3.5).

    Each product of a sum of m carries at most m roundings, and one each of matrix and reading in single precision:
    ‖x − x₀‖ ≤ γ ‖|R| |y|‖ with γ = k u/(1 − k u), k = m + 2 and u half the precision's machine epsilon.
    """
    roundings = (matrix.shape[1] + 2) * float(np.finfo(precision).eps) / 2
    most = np.linalg.norm(np.abs(changes) @ np.abs(matrix).T, axis=1) / np.linalg.norm(changes @ matrix.T, axis=1)
    return float(roundings / (1 - roundings) * most.max())


def test_rounding_stays_within_its_bound_in_both_precisions():
    readings = base_scene_readings(1)
    prepared = linear(make_method(RECIPES_METHOD).prepare(imaging_problem(readings.sensor_type)))
    changes = sensor_changes(readings, 0, prepared)[1]
    bound = {precision: error_bound(prepared.matrix, changes, precision) for precision in ("float32", "float64")}
    for batch in (1, 16):
        errors = {name: measure_precision(name, batch).accuracy["image_error"].value for name in bound}
        assert errors["float64"] <= bound["float64"]
        assert bound["float64"] < errors["float32"] <= bound["float32"]


def test_the_bound_holds_for_the_matrix_that_cancels_most():
    random = np.random.default_rng(3)
    matrix = random.standard_normal((20, 208)) * 10.0 ** random.uniform(-4, 4, (20, 208))
    changes = random.standard_normal((5, 208))
    exact = changes.astype(np.longdouble) @ matrix.astype(np.longdouble).T
    found = relative_error(make_imager(matrix, "float32")(changes), exact)
    assert 0 < found <= error_bound(matrix, changes, "float32")


def test_readings_cost_memory_with_the_block_and_half_of_it_in_single_precision():
    few, many, half = (measure_precision(*how) for how in (("float64", 1), ("float64", 16), ("float32", 16)))
    assert few.costs["memory_bytes"] < many.costs["memory_bytes"] == 2 * half.costs["memory_bytes"]


# --- the page --------------------------------------------------------------------------------------------


def test_the_page_has_a_table_of_every_series():
    page = Path(__file__).parents[4] / "docs" / "reference" / "frontier.md"
    tables = re.findall(r"<!-- table: (.+?) -->\n+(\|.+?\|)\n+<!-- end -->", page.read_text(), re.S)
    computer = {work.what.split(": ")[0] for work in plan_computer_work()}
    ways = (
        *list_parts_of_paper(),
        *list_parts_of_even(),
        *list_choices_of_even(),
        *list_simulated_ways(),
    )
    station = {series for series, _ in ways}
    assert {name for name, _ in tables} == computer | station
    assert all(len(table.splitlines()) > 4 for _, table in tables)


# --- tasks -----------------------------------------------------------------------------------------------


@pytest.mark.rest
def test_tasks_have_keys_of_their_own_that_stay_the_same():
    for quick in (True, False):
        keys = [work.key for work in plan_computer_work(quick=quick)]
        assert len(set(keys)) == len(keys)
        assert keys == [work.key for work in plan_computer_work(quick=quick)]
    assert {work.key for work in plan_computer_work(quick=True)} != set(keys)


def test_a_task_is_the_same_point_in_another_process_and_out_of_a_file():
    work = next(work for work in plan_computer_work(quick=True) if "reconstruction" in work.what)
    (here,), (there,) = work.run(), pickle.loads(pickle.dumps(work)).run()
    assert there.accuracy == here.accuracy
    assert there.knobs == here.knobs
    assert restore(Point, json_document(here)) == here


def test_settings_of_the_same_arithmetic_are_not_told_apart_by_the_clock():
    def point(series, error, compute_s, size):
        accuracy = {"E_CoM": Accuracy(error, 0.1, "mm")}
        return Point(TimeBasis.COMPUTER, series, {}, accuracy, compute_s, None, 3, "", {"memory_bytes": size})

    def worth(*points):
        return [point.pareto for point in mark_worth_of_computer(points)]

    one, other = point("reconstruction", 1.0, 1.0e-4, 8.0), point("reconstruction", 0.95, 1.1e-4, 8.0)
    assert worth(one, other) == [False, True]
    larger = replace(other, costs={"memory_bytes": 16.0})  # that it takes longer is then its own doing
    assert worth(one, larger) == [True, False]
    assert worth(one, replace(other, series="another")) == [True, True]


def test_a_burst_is_timed_as_a_whole_and_what_comes_of_it_kept():
    calls = []
    assert fastest_s(lambda: calls.append(sum(range(2000))), 2) > 0
    assert len(calls) > 2
    found, seconds = time_call(lambda: 7)
    assert found == 7
    assert seconds >= 0
