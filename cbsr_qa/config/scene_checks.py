"""Checks of a scene's loads against the size of the sheet."""

import math
from collections.abc import Iterator

import numpy as np

from cbsr_qa.config.loader import Loaded
from cbsr_qa.config.tables import refusal
from cbsr_qa.config.text import plainly
from cbsr_qa.domain.plan.scene_plan import PressTimes, SceneLoad, ScenePlan, approach_s, press_times
from cbsr_qa.domain.plan.steps import distance_mm, travel_s
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.plugin.problems import Problem
from cbsr_qa.simulate.sheet import finest_mesh_mm

_ROUNDING_S = 1e-9  # tolerance of times that are sums of others
_PER_SIDE = 16  # number of points on a head's side that are compared with the sheet's edge

#: A load, its place in the file's list, and when it is pressed.
_Timed = tuple[int, SceneLoad, PressTimes]


def check_plan(loaded: Loaded[ScenePlan], sensor_type: SensorType) -> None:
    """Check a scene's mesh, and where and when its loads are pressed.

    Raises
    ------
    ConfigError
        If the mesh is too fine for the sheet; listing every load whose centre is off the sheet, that its head cannot
        press in time, or that collides with another head, each with the allowed values.
    """
    plan = loaded.value
    finest_mm = finest_mesh_mm(sensor_type)
    if plan.scene.sheet_mesh_size_mm < finest_mm:
        finding = f"is {plainly(plan.scene.sheet_mesh_size_mm)}; on this sheet it must be at least {finest_mm:g}"
        raise refusal(loaded.document, [Problem(("scene", "sheet_mesh_size_mm"), finding)])
    timed = [
        (index, load, press_times(load, load.strain * sensor_type.thickness_mm, plan.motion))
        for index, load in enumerate(plan.loads)
    ]
    problems = [
        Problem(
            ("loads", index, "x_mm"),
            f"is {plainly(load.x_mm)} with y_mm = {plainly(load.y_mm)}, off the sheet;"
            f" the sheet {sensor_type.outline.words()}",
        )
        for index, load in enumerate(plan.loads)
        if _clearance_mm(sensor_type, load) < 0
    ]
    problems += [*_early_problems(plan, timed), *_late_problems(plan, timed)]
    problems += _meeting_heads(plan.indenter, timed)
    if problems:
        raise refusal(loaded.document, sorted(problems, key=lambda problem: problem.path[1]))


def edge_remarks(plan: ScenePlan, sensor_type: SensorType) -> dict[int, str]:
    """Remark on loads (numbered from 0) whose head is partly over the sheet's edge."""
    return {
        index: f"loads[{index + 1}]: the head ({plan.indenter.words()}) at ({load.x_mm:zg}, {load.y_mm:zg}) mm is"
        " partly over the sheet's edge; only what lies on the sheet is pressed"
        for index, load in enumerate(plan.loads)
        if _is_over_edge(plan.indenter, load, sensor_type)
    }


def _is_over_edge(head: Indenter, load: SceneLoad, sensor_type: SensorType) -> bool:
    if not head.outline_mm:
        return _clearance_mm(sensor_type, load) < head.radius_mm
    corners = head.footprint_at(*load.place_mm).outline_mm()
    fractions = np.linspace(0, 1, _PER_SIDE)[:, None, None]
    outline = (corners + fractions * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    return bool((sensor_type.outline.clearance_mm(outline) < 0).any())


def _clearance_mm(sensor_type: SensorType, load: SceneLoad) -> float:
    return float(sensor_type.outline.clearance_mm(np.array([load.place_mm]))[0])


def _early_problems(plan: ScenePlan, timed: list[_Timed]) -> Iterator[Problem]:
    """Yield loads that begin before their head can be there; every head waits over the centre at first."""
    latest_by_head: dict[int, _Timed] = {}
    for press in sorted(timed, key=lambda each: each[1].start_s):
        index, load, times = press
        earlier = latest_by_head.get(load.head)
        place, free_s = ((0.0, 0.0), 0.0) if earlier is None else (earlier[1].place_mm, earlier[2].up_s)
        way_s = travel_s(plan.motion, distance_mm(place, load.place_mm)) + approach_s(plan.motion)
        if load.start_s < free_s + way_s - _ROUNDING_S:
            reason = _why_too_soon(load, earlier, free_s, way_s)
            yield Problem(("loads", index, "start_s"), f"is {plainly(load.start_s)}; {reason}")
        if earlier is None or times.up_s > earlier[2].up_s:
            latest_by_head[load.head] = press


def _why_too_soon(load: SceneLoad, before: _Timed | None, free_s: float, way_s: float) -> str:
    earliest = f"the earliest start that works is {_round_up(free_s + way_s)}"
    if before is None:
        return f"head {load.head} needs {_round_up(way_s)} s from over the centre to the surface here: {earliest}"
    busy = f"head {load.head} is busy with loads[{before[0] + 1}] until {free_s:.2f} s"
    return f"{busy} and needs {way_s:.2f} s from there to the surface here: {earliest}"


def _late_problems(plan: ScenePlan, timed: list[_Timed]) -> Iterator[Problem]:
    if plan.duration_s is None:
        return
    for index, load, times in timed:
        if times.up_s > plan.duration_s + _ROUNDING_S:
            finding = f"is {plainly(load.hold_s)}; after it the head is up at {times.up_s:.2f} s"
            allowed = f"recording.duration_s is {plan.duration_s:g}; it must be at least {_round_up(times.up_s)}"
            yield Problem(("loads", index, "hold_s"), f"{finding}, when the recording is over: {allowed}")


def _meeting_heads(head: Indenter, timed: list[_Timed]) -> Iterator[Problem]:
    """Yield presses of two heads that are below the hover height at the same time and would collide."""
    presses_below: list[_Timed] = []
    for press in sorted(timed, key=lambda each: each[2].leaves_s):
        index, load, times = press
        presses_below = [earlier for earlier in presses_below if earlier[2].up_s > times.leaves_s + _ROUNDING_S]
        for earlier in presses_below:
            if earlier[1].head != load.head and _overlap(head, load, earlier[1]):
                yield Problem(("loads", index), _why_meeting(head, press, earlier))
        presses_below.append(press)


def _why_meeting(head: Indenter, one: _Timed, other: _Timed) -> str:
    (_, load, times), (number, standing, standing_times) = one, other
    distance = f"{distance_mm(load.place_mm, standing.place_mm):.3g} mm from loads[{number + 1}]"
    collision = (
        f"puts head {load.head} {distance}, where head {standing.head} is down until {standing_times.up_s:.2f} s"
    )
    remedy = (
        f"move one of them, or start this one at {_round_up(standing_times.up_s + times.touches_s - times.leaves_s)}"
    )
    return f"{collision}: two heads ({head.words()}) would overlap; {remedy}"


def _overlap(head: Indenter, load: SceneLoad, other: SceneLoad) -> bool:
    if not head.outline_mm:
        return distance_mm(load.place_mm, other.place_mm) < head.diameter_mm
    corners = head.footprint_at(*other.place_mm).outline_mm()
    shared = head.footprint_at(*load.place_mm).area_under_edges_mm2(corners, np.roll(corners, -1, axis=0)).sum()
    return bool(shared > 1e-9 * head.area_mm2)


def _round_up(time_s: float) -> str:
    """Round a time up so that the printed value works."""
    return f"{math.ceil(100 * time_s - 1e-6) / 100:.2f}"
