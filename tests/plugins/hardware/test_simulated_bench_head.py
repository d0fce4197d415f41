"""The simulated bench: how its head moves, presses and finds the surface, and how long it takes."""

from itertools import chain

import numpy as np
import pytest
from simulated_benches import SPEED, lying, opened
from simulated_setting import MOTION, context, scene, truth
from tiers import rest_but

from cbsr_qa.config.loader import load_station
from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.steps import FindSurface, Hold, Press, Release, stroke_s, surface_search_s, travel_s
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.run.events import LoadFinished
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.bench import Bench, Mounted
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import example_identity, example_plan
from cbsr_qa_plugins.hardware.simulated_bench import open_bench


def test_a_press_is_a_ramp_of_the_asked_strain_rate():
    clock, bench = opened(lying(None))
    bench.press(0.8, SPEED)
    (press,) = bench.world.presses
    (ramp,) = press.steps
    assert ramp.change == pytest.approx(0.2)
    assert ramp.change / ramp.ramp_s == pytest.approx(1 / 6)  # the paper's 16.67 %/s
    assert ramp.start_s + ramp.ramp_s == pytest.approx(clock.now())
    bench.release()
    assert press.strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)


def test_travelling_lifts_the_head_first():
    clock, bench = opened(lying(None))
    bench.press(0.8, SPEED)
    bench.move_to(20.0, 0.0)
    bench.press(0.4, SPEED)
    first, second = bench.world.presses
    assert first.strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)
    assert (second.index, second.x_mm, second.strain_at(clock.now())) == (1, 20.0, pytest.approx(0.1))


def test_the_safe_state_lifts_at_once_and_may_be_called_again():
    clock, bench = opened(lying(None))
    bench.press(0.8, SPEED)
    before = clock.now()
    bench.safe_state()
    bench.safe_state()
    assert clock.now() == before
    clock.sleep(1.0)
    assert bench.world.presses[0].strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)
    bench.press(0.8, SPEED)  # waits until the head is up, then goes down as ever
    assert clock.now() == pytest.approx(before + 25.8 / 10.0 + stroke_s(MOTION, 0.8))


@pytest.mark.parametrize("seed", rest_but({0}, range(6)))
def test_the_surface_is_found_to_a_hundredth_of_a_millimetre(seed: int):
    clock, bench = opened(lying(0.08), seed=seed)
    start = clock.now()
    found = bench.find_surface(20.0, -10.0)
    took_s = clock.now() - start - travel_s(MOTION, np.hypot(20.0, 10.0))
    true = MOTION.hover_mm + bench.world.surface_mm(20.0, -10.0, 0.0)
    assert found == pytest.approx(true, abs=0.015)
    assert took_s == pytest.approx(surface_search_s(MOTION), rel=0.25)


def test_in_a_scene_that_says_nothing_of_it_the_sheet_lies_exactly_flat():
    for of in (scene(), scene("elastic-stress")):
        clock, bench = opened(of)
        assert {bench.world.surface_mm(x, y, 3.0) for x in (-30.0, 0.0, 20.0) for y in (0.0, 15.0)} == {0.0}
        bench.press(0.8, SPEED)
        assert bench.world.presses[0].strain_at(clock.now()) == pytest.approx(0.2, abs=1e-15)


def test_a_press_starts_from_the_surface_that_was_found():
    clock, bench = opened(lying(0.1), seed=3)
    bench.find_surface(0.0, 0.0)
    bench.press(0.8, SPEED)
    assert bench.world.presses[-1].strain_at(clock.now()) == pytest.approx(0.2, abs=0.004)


def test_finding_the_surface_leaves_a_residue_that_a_rest_takes_away():
    clock, bench = opened()
    bench.find_surface(0.0, 0.0)
    fresh = abs(truth(bench.world, clock.now())[0].relative_change)
    assert fresh > 1e-3
    assert abs(truth(bench.world, clock.now() + 240.0)[0].relative_change) < 1e-3 * fresh


def test_without_a_sheet_that_resists_the_surface_is_not_found():
    clock, bench = opened(scene())
    with pytest.raises(InstrumentError, match=r"bench at \(5, 0\) mm: no contact force of 0.2 N") as lost:
        bench.find_surface(5.0, 0.0)
    assert "elastic-stress" in lost.value.remedy
    assert bench.world.presses[0].strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("strain", [0.05, 0.2, 0.3])
def test_loads_record_when_the_head_left_the_sheet(strain: float):
    clock, bench = opened()
    loads = [Load(f"L{i}", *place, strain, 0) for i, place in enumerate(NINE_LOCATIONS_MM[:3])]
    surfaces = [FindSurface(load.x_mm, load.y_mm) for load in loads]
    cycles = [(Press(load), Hold(10.0, acquire=False), Release(), Hold(10.0, acquire=False)) for load in loads]
    told: list[object] = []
    plan = example_plan([*surfaces, *chain.from_iterable(cycles)])
    mounted = Mounted(load_station("simulated").value.instruments[0], bench)
    ended = execute(plan, example_identity(), Bench([mounted]), clock, [told.append])
    assert ended.end is EndReason.FINISHED, ended.detail
    records = [event.record for event in told if isinstance(event, LoadFinished)]
    presses = bench.world.presses[-len(loads) :]  # after those of the surface search
    for record, press in zip(records, presses, strict=True):
        up = press.steps[-1]
        assert press.strain_at(record.release_start_s) == pytest.approx(strain, abs=0.004)
        assert up.change < 0
        assert record.clear_s == pytest.approx(up.start_s + up.ramp_s, abs=0.05)


def test_an_eased_press_goes_straight_to_its_depths_and_the_world_knows_from_where():
    """Strains up and down in one press of the world; the loop's upper branch is seen on the way back alone."""
    width = 0.1
    clock, bench = opened(scene("piezoresistivity", "hysteresis", hysteresis={"width": width}))
    gauge, changes, strains = bench.world.setting.material.against_strain.slope.value, [], []
    for strain in (0.05, 0.1, 0.2, 0.1, 0.05):
        bench.press(strain * 4.0, SPEED)
        (true,) = truth(bench.world, clock.now())
        strains.append(true.strain)
        changes.append(true.relative_change)
    assert strains == pytest.approx([0.05, 0.1, 0.2, 0.1, 0.05])
    above = [0.0, 0.0, 0.0, width * gauge * 0.2, 0.75 * width * gauge * 0.2]
    assert changes == pytest.approx([gauge * s + more for s, more in zip(strains, above, strict=True)])
    (press,) = bench.world.presses
    assert [step.ramp_s * SPEED for step in press.steps] == pytest.approx([0.2, 0.2, 0.4, 0.4, 0.2])


def test_a_head_told_to_stay_stays_whatever_its_position_errors():
    of = scene(
        "elastic-stress",
        "applicator-position-error",
        applicator_position_error={"error_mm": 0.1, "depth_error_mm": 0.05},
    )
    clock = VirtualClock()
    bench = open_bench(context(of, clock=clock))
    bench.press(0.8, 0.5)
    before = [list(press.steps) for press in bench.world.presses]
    bench.press(0.8, 0.5)
    assert [list(press.steps) for press in bench.world.presses] == before
    assert np.isfinite(bench.world.force_N(clock.now(), 0))
