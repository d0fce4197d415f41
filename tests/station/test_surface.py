"""The surface as a plane, the lowered hover height, and a first rest that ends when the sheet is stable."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from runner_samples import cycle, kinds, run

from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.domain.plan.steps import (
    FindSurface,
    Hold,
    LowerHover,
    MarkUnloaded,
    Press,
    Settle,
    StrainStep,
    TouchPlane,
    spread_mm,
)
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.run.events import FramesTaken, StepRetried, StepStarted, Unloaded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.execution import execute
from cbsr_qa.station.noise import relative_drift
from cbsr_qa.station.plan import schedule
from cbsr_qa.station.setup import open_station, plan_of, station_clock
from cbsr_qa.station.surface import SheetSurface, contact_depth_mm, fit_plane
from cbsr_qa.studies.simulated import configuration_of, copy_shipped
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench

CORNERS = ((30.0, 0.0), (-15.0, 26.0), (-15.0, -26.0))
MOTION = Motion(press_speed_mm_s=2 / 3, travel_speed_mm_s=10.0, hover_mm=25.0)


def depths(plane, places=CORNERS):
    level, along_x, along_y = plane
    return {(x, y): level + along_x * x + along_y * y for x, y in places}


# --- the plane -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("places", [CORNERS, (*CORNERS, (0.0, 0.0), (10.0, -5.0))])
def test_touches_give_back_the_plane_they_are_of(places):
    found = fit_plane(depths((25.1, 0.003, -0.002), places), 0.05)
    assert (found.level_mm, *found.slope) == pytest.approx((25.1, 0.003, -0.002), abs=1e-12)
    assert found.depth_mm((7.0, 9.0)) == pytest.approx(25.1 + 0.021 - 0.018, abs=1e-12)


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (depths((25.0, 0.0, 0.0), ((0.0, 0.0), (10.0, 10.0), (20.0, 20.0))), "lie in a line"),
        (depths((25.0, 0.0, 0.0), ((0.0, 0.0), (10.0, 10.0))), "lie in a line"),
        (depths((25.0, 0.02, 0.01)), "it is tilted by 2.2 mm over 100 mm; a stage is by 2 mm at most"),
        ({**depths((25.0, 0.0, 0.0)), (0.0, 0.0): 25.4}, r"the surface at \(0, 0\) mm is 0.3 mm off it"),
    ],
)
def test_touches_that_give_no_plane_are_named(found, reason):
    with pytest.raises(InstrumentError, match=reason):
        fit_plane(found, 0.1)


def test_spread_is_the_distance_from_the_nearest_line():
    assert spread_mm([(0, 0), (10, 5), (20, 10)]) == pytest.approx(0, abs=1e-9)
    assert spread_mm([(-10, 2), (10, 2), (-10, -2), (10, -2)]) == pytest.approx(2)


@pytest.mark.parametrize("surface_mm", [-0.15, 0.0, 0.2])
def test_contact_is_where_the_force_begins(surface_mm):
    times = np.arange(0.05, 3.0, 0.125)
    depth = 1.0 - MOTION.press_speed_mm_s * (2.9 - times)
    force = 0.03 + 5.0 * np.clip(depth - surface_mm, 0, None)  # the cell has an offset
    samples = SampleBlock("force", "N", times, force)
    assert contact_depth_mm(samples, 2.9, 1.0, MOTION.press_speed_mm_s) == pytest.approx(surface_mm, abs=0.02)
    assert contact_depth_mm(samples.select_interval(2.8, 2.9), 2.9, 1.0, MOTION.press_speed_mm_s) is None


class Guided:
    """Notes what it is told."""

    def __init__(self):
        self.expected, self.lowered_mm = {}, 0.0

    def expect_surface(self, x_mm, y_mm, depth_mm):
        self.expected[(x_mm, y_mm)] = depth_mm

    def lower_hover(self, by_mm):
        self.lowered_mm = by_mm


def surface_with_plane(plane=(25.1, 0.003, 0.004)):
    head = Guided()
    surface = SheetSurface(head, MOTION, 47.5)
    for (x_mm, y_mm), depth_mm in depths(plane).items():
        surface.add(TouchPlane(x_mm, y_mm, 0.1), depth_mm)
    return head, surface


def test_presses_between_the_touches_go_by_the_plane():
    head, surface = surface_with_plane()
    surface.expect((10.0, 10.0))
    surface.expect(CORNERS[0])  # found itself
    assert head.expected == {(10.0, 10.0): pytest.approx(25.17)}


def test_the_hover_height_clears_the_highest_point_that_the_surface_may_have():
    head, surface = surface_with_plane()
    surface.lower_hover(2.0)
    assert head.lowered_mm == pytest.approx(25.1 - 0.005 * 47.5 - 2.0)
    surface.forget()
    surface.lower_hover(2.0)
    assert head.lowered_mm == pytest.approx(22.5)  # the search begins 0.5 mm above nominal
    surface.lower_hover(None)
    assert head.lowered_mm == 0


def test_contacts_are_compared_with_those_at_places_that_were_found():
    _, surface = surface_with_plane()
    assert surface.check_contact(CORNERS[0], 0.3) == ""  # the force lags behind the depth
    assert surface.check_contact((0.0, 0.0), 0.36) == ""
    assert "0.15 mm below the plane" in surface.check_contact((0.0, 0.0), 0.45)
    assert "0.20 mm above the plane" in surface.check_contact((0.0, 0.0), 0.1)
    assert "too few forces" in surface.check_contact((0.0, 0.0), None)


# --- on the simulated bench ------------------------------------------------------------------------------

GRID = ((0.0, 0.0), (30.0, 0.0), (-30.0, 0.0), (0.0, 30.0), (15.0, 15.0), (0.0, -30.0))


def recipe(**options):
    grid = {"name": "grid", "sequence": "location-grid", "locations_mm": [list(place) for place in GRID]}
    times = {"hold_s": 10.0, "rest_s": 5.0, "initial_rest_s": 10.0}
    document = copy_shipped(DocumentKind.RECIPE, "nine-locations")
    document["recipe"] = {"name": "surface", "calibrate_phases": ["grid"]}
    return {**document, "limits": [], "failure_codes": {}, "phases": [{**grid, **times, **options}]}


def prepared(seat=None, **options):
    """Plan, bench and clock of a station whose sheet is seated in some way."""
    station, scene = copy_shipped(DocumentKind.STATION, "simulated"), copy_shipped(DocumentKind.SCENE, "base")
    others = [effect for effect in scene["effects"] if effect["name"] != "sheet-seat"]
    scene["effects"] = [{"name": "sheet-seat", "error_mm": 0.05, **(seat or {})}, *others]
    station["instruments"]["bench"]["scene"] = scene
    plugins = discover()
    configuration = configuration_of(station, recipe(**options), "cbsr-8wt", seed=5)
    clock = station_clock(configuration)
    return plan_of(configuration, plugins), open_station(configuration, plugins, clock), clock


def executed(seat=None, **options):
    plan, bench, clock = prepared(seat, **options)
    documents = []
    ended = execute(plan, example_identity(), bench, clock, [documents.append])
    return plan, bench, documents, ended


def strains_by_place(bench):
    """Largest true strain of the last press at each place."""
    world = bench.frame_source.world
    return {
        (press.x_mm, press.y_mm): max(np.cumsum([step.change for step in press.steps])) for press in world.presses
    }


def test_presses_by_the_plane_of_a_tilted_sheet_are_as_deep_as_those_at_found_surfaces():
    _, bench, documents, ended = executed(surface="plane")
    assert ended.end is EndReason.FINISHED, ended.detail
    touched = [document.step for document in kinds(documents, StepStarted) if isinstance(document.step, FindSurface)]
    assert len(touched) == 3
    assert kinds(documents, StepRetried) == []
    strains = strains_by_place(bench)
    assert set(strains) == set(GRID)
    assert np.array(list(strains.values())) == pytest.approx(0.2, abs=0.02 / 4)  # 0.02 mm of 4 mm


def test_where_a_bent_sheet_leaves_the_plane_its_surface_is_found_and_the_press_repeated():
    _, bench, documents, ended = executed({"bend_mm": 0.12, "bend_correlation_mm": 20.0}, surface="plane")
    assert ended.end is EndReason.FINISHED, ended.detail
    retried = kinds(documents, StepRetried)
    assert 0 < len(retried) <= 3
    assert all("the plane: its surface is found again" in document.why for document in retried)
    assert np.array(list(strains_by_place(bench).values())) == pytest.approx(0.2, abs=0.12 / 4)
    started = [document.step for document in kinds(documents, StepStarted)]
    assert sum(isinstance(step, Press) for step in started) == len(GRID)


def test_a_fourth_touch_off_the_plane_ends_the_run_before_any_press():
    touches = [list(place) for place in GRID]
    bent = {"bend_mm": 0.3, "bend_correlation_mm": 15.0}
    _, _, documents, ended = executed(bent, surface="plane", touches_mm=touches)
    assert ended.end is EndReason.BROKEN
    assert "it is no plane: the surface at" in ended.detail
    assert not any(isinstance(document.step, Press) for document in kinds(documents, StepStarted))


@pytest.mark.parametrize(
    "options",
    [
        {"surface": "plane"},
        {"clearance_mm": 2.0},
        {"surface": "plane", "clearance_mm": 1.5},
        {"residue_percent": 1.0, "rest_s": 60.0},
    ],
)
def test_the_dry_run_says_what_the_run_takes(options):
    plan, _, _, ended = executed(**options)
    dry = dry_run(plan, 2.5)
    assert dry.violations == ()
    homing_s = dict(dry.spent)["home"]  # the simulated head is at home already
    assert ended.time_s == pytest.approx(dry.duration_s - homing_s, rel=0.01)
    plain = prepared(rest_s=options.get("rest_s", 5.0))[0]
    assert dry.duration_s < dry_run(plain, 2.5).duration_s - 15


@pytest.mark.parametrize(("clearance_mm", "refused"), [(0.5, True), (1.0, False), (25.0, False), (30.0, True)])
def test_the_station_says_how_low_the_head_may_travel(clearance_mm, refused):
    plan, *_ = prepared(clearance_mm=clearance_mm)
    assert any("mm above the sheet; the station allows 1 to 25 mm" in it for it in dry_run(plan, 2.5).violations) is (
        refused
    )


def test_an_applicator_that_is_not_guided_is_refused_before_anything_moves():
    with pytest.raises(ConfigError, match="does not take a surface"):
        run((LowerHover(2.0), *cycle(0)))
    with pytest.raises(ConfigError, match="does not take a surface"):
        run((*(TouchPlane(x, y, 0.1) for x, y in CORNERS), *cycle(0)))


def test_a_resumed_run_touches_the_plane_again():
    plan, *_ = prepared(surface="plane", clearance_mm=2.0)
    (whole,) = schedule(plan)
    (rest,) = schedule(plan, frozenset({(0, 0), (0, 1)}))
    set_up = [s for s in whole.steps if isinstance(s.step, FindSurface | LowerHover)]
    assert [s for s in rest.steps if isinstance(s.step, FindSurface | LowerHover)] == set_up
    assert len(set_up) == 4


# --- the first rest --------------------------------------------------------------------------------------


def frames(drift=0.0, noise=1e-3, count=12, seed=0):
    random = np.random.default_rng(seed)
    voltages = 1 + noise * random.standard_normal((count, 16, 16))
    voltages += drift * np.linspace(-1, 1, count)[:, None, None]
    flags = np.zeros(voltages.shape, np.uint8)
    return FrameBlock(np.arange(count) * 2.5, voltages, flags, VoltageUnit.VOLT, 1e-3)


def test_drift_is_measured_in_units_of_the_noise():
    usable = np.ones((16, 16), dtype=bool)
    still = [relative_drift(frames(seed=seed), usable) for seed in range(200)]
    assert np.mean(np.square(still)) < 0.15**2
    moving = [relative_drift(frames(drift=1e-3, seed=seed), usable) for seed in range(50)]
    halves = 1e-3 * 12 / 11  # difference of the means of the halves of a ramp from −1 to 1
    assert np.mean(moving) == pytest.approx(halves / 1e-3, rel=0.05)
    assert relative_drift(frames(noise=0.0), usable) == 0
    assert relative_drift(frames(), ~usable) == float("inf")
    assert relative_drift(frames(drift=1e-3, noise=0.0), usable) > 1


def test_the_first_rest_ends_when_the_sheet_is_stable():
    plan, _, documents, _ = executed(drift=0.25, initial_rest_s=240.0, least_initial_rest_s=30.0)
    (unloaded,) = kinds(documents, Unloaded)
    (settle,) = [d for d in kinds(documents, StepStarted) if isinstance(d.step, Settle)]
    rested_s = unloaded.time_s - settle.time_s
    assert 30 <= rested_s < 180
    dry = dry_run(plan, 2.5)
    assert dry.sooner_s == 210
    taken = [f for f in kinds(documents, FramesTaken) if settle.time_s < f.frames.time_s[0] < unloaded.time_s]
    last = taken[-12:]
    assert len(taken) * 2.5 == pytest.approx(rested_s)
    usable = plan.sensor_type.pattern.usable()
    whole = replace(
        last[0].frames,
        time_s=np.concatenate([f.frames.time_s for f in last]),
        voltages=np.concatenate([f.frames.voltages for f in last]),
        flags=np.concatenate([f.frames.flags for f in last]),
    )
    assert relative_drift(whole, usable) < 0.25  # the stored frames tell why


def test_a_rest_that_finds_no_end_lasts_as_long_as_the_recipe_says():
    script = Script(VirtualClock())
    plan = example_plan((Settle(40.0, acquire=True, least_s=5.0, drift=0.0), MarkUnloaded(), *cycle(0)))
    documents = []
    bench = make_scripted_bench(script, plan.sensor_type)
    ended = execute(plan, example_identity(), bench, script.clock, [documents.append])
    assert ended.end is EndReason.FINISHED
    (unloaded,) = kinds(documents, Unloaded)
    assert unloaded.time_s == pytest.approx(40.0)
    assert not any(isinstance(d.step, StrainStep) for d in kinds(documents, StepStarted))
    assert sum(isinstance(d.step, Hold) for d in kinds(documents, StepStarted)) == 3


@pytest.mark.rest
def test_a_printer_travels_just_clear_of_a_tilted_sheet_and_meets_it_where_the_plane_says():
    station, worlds, documents = copy_shipped(DocumentKind.STATION, "bench-emulated"), [], []
    options = {"surface": "plane", "clearance_mm": 1.0, "hold_s": 5.0}
    configuration = configuration_of(station, recipe(**options), "cbsr-8wt", seed=5)
    plugins, clock = discover(), station_clock(configuration)
    plan = plan_of(configuration, plugins)
    with closing(open_station(configuration, plugins, clock, emulated=worlds.append)) as bench:
        ended = execute(plan, example_identity(), bench, clock, [documents.append])
    assert ended.end is EndReason.FINISHED, ended.detail
    assert kinds(documents, StepRetried) == []
    assert worlds[0].rig.head.dragged == 0
    assert ended.time_s == pytest.approx(dry_run(plan, 2.5).duration_s, rel=0.05)
