"""Emulated instruments whose numbers belong to the step of a run, whenever it is done and whatever was before it."""

import numpy as np
import pytest
from simulated_setting import MOTION, scene, world

from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.samplers import EmulatedLoadCell
from cbsr_qa.simulate.instruments.streams import WatchedClock

SPEED_MM_S = 40 / 60
CENTRE_MM, HOVER_Z_MM = (125.0, 105.0), 60.0
EFFECTS = {"load_cell_noise": {"rms_N": 0.01}, "applicator_position_error": {"error_mm": 0.1, "depth_error_mm": 0.01}}


class Station:
    """A rig and a load cell that sends into a list of (time, line)."""

    def __init__(self, *, rate_hz=8.0):
        noisy = scene("piezoresistivity", "elastic-stress", "measurement-noise", "load-cell-noise",
                      "applicator-position-error", **EFFECTS)  # fmt: skip
        self.rig = EmulatedRig(WatchedClock(), world(noisy), MOTION)
        self.rig.head.mount_over(CENTRE_MM, HOVER_Z_MM)
        self.lines = []
        self.cell = EmulatedLoadCell(self.rig, {"time": "arrival", "rate_hz": rate_hz}, self._note)

    def _note(self, data):
        self.lines += [float(line) for line in data.split()]

    def go(self, x_mm, y_mm, depth_mm, speed_mm_s):
        with self.rig.lock:
            z_mm = HOVER_Z_MM - MOTION.hover_mm - depth_mm
            self.rig.head.go((CENTRE_MM[0] + x_mm, CENTRE_MM[1] + y_mm, z_mm), speed_mm_s)
            left_s = self.rig.head.free_at_s - self.rig.clock.now()
        self.rig.clock.sleep(left_s)

    def press(self):
        """Travel, press, take two frames, and lift; return strains, readings, and forces from the press on."""
        self.rig.begin_step(1, 5)
        self.go(12.0, -7.0, -3.0, 100.0)
        self.lines.clear()
        self.go(12.0, -7.0, 0.8, SPEED_MM_S)
        self.rig.begin_step(1, 6)
        frames = []
        for _ in range(2):
            frames.append(self.rig.frame().voltages)
            self.rig.wiring.frame += 1
            self.rig.clock.sleep(2.5)
        self.rig.begin_step(1, 7)
        self.go(12.0, -7.0, -3.0, SPEED_MM_S)
        return self.rig.world.presses[-1].steps[0].change, np.array(frames), list(self.lines)


@pytest.mark.parametrize("earlier_s", [0.03, 77.7777])
@pytest.mark.parametrize("height_mm", [3.0, 25.0], ids=["just clear", "hovering"])
def test_a_press_gives_the_same_numbers_wherever_the_head_came_from(earlier_s, height_mm):
    first, again = Station(), Station()
    first.go(0.0, 0.0, -3.0, 100.0)
    again.rig.clock.sleep(earlier_s)
    again.rig.begin_step(0, 3)
    again.go(-20.0, 10.0, -height_mm, 100.0)
    if height_mm > 3.0:
        again.rig.begin_step(1, 5)
        again.go(-20.0, 10.0, -3.0, 100.0)
    (strain, frames, forces), (strain_again, frames_again, forces_again) = first.press(), again.press()
    assert strain == strain_again
    np.testing.assert_array_equal(frames, frames_again)
    assert forces == forces_again
    assert len(forces) > 80


def test_another_step_gives_other_numbers():
    station = Station()
    _, frames, forces = station.press()
    station.rig.begin_step(2, 5)
    assert (station.rig.frame().voltages != frames[0]).any()
    station.lines.clear()
    station.rig.clock.sleep(1.0)
    assert set(station.lines).isdisjoint(forces)


def test_a_slow_cell_is_heard_during_many_short_orders():
    station = Station(rate_hz=1.0)
    station.rig.begin_step(0, 0)
    for number in range(40):
        station.go(0.0, 0.0, -10.0 + 0.1 * number, 0.5)
    assert len(station.lines) >= 8
