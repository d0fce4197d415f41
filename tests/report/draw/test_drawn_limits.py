"""Charts of places show the limits of the recipe, not others."""

import re
from dataclasses import replace

import pytest
from report_samples import sample_run

from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.report.draw.loads import location_map_figure
from cbsr_qa.report.select import Measured, join_loads, loads_of


@pytest.fixture(scope="module")
def seen():
    result = sample_run()
    run = result.observation
    return join_loads(loads_of(run, Role.GRID), run, Measured(result.measurements)), run.record.sensor_type


def words(svg):
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def dashed(svg):
    return svg.count("stroke-dasharray")


@pytest.mark.parametrize(
    ("overlap", "error_mm", "ticks", "lines"),
    [
        ((), (), {"0", "50", "100"}, 0),
        ((75.0,), (), {"0", "50", "75", "100"}, 1),
        ((55.0, 97.5), (), {"0", "55", "97.5"}, 2),
        ((), (2.25,), {"2.25"}, 1),
        ((), (6.5,), {"limit 6.5, not shown"}, 0),
    ],
)
def test_limits_are_drawn_where_the_recipe_has_them(seen, overlap, error_mm, ticks, lines):
    loads, sensor = seen
    bare = [replace(load, overlap_limits_percent=(), error_limits_mm=()) for load in loads]
    limited = [replace(load, overlap_limits_percent=overlap, error_limits_mm=error_mm) for load in bare]
    drawn = location_map_figure(limited, sensor)
    assert ticks <= set(words(drawn))
    assert "70" not in words(drawn)
    assert dashed(drawn) - dashed(location_map_figure(bare, sensor)) == lines


def test_bounds_of_limits_come_with_their_measurements():
    result = sample_run()
    judged = [
        m.judge(Limit("area_overlap", "%", 75.0, 100.0)) if m.name == "area_overlap" else m
        for m in result.measurements
    ]
    run = result.observation
    loads = join_loads(loads_of(run, Role.GRID), run, Measured(judged))
    assert {load.overlap_limits_percent for load in loads} == {(75.0, 100.0)}
