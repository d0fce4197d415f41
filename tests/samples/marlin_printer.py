"""An emulated Marlin printer and its driver, for tests of that."""

import threading

from emulated_bench import WorldForce

from cbsr_qa_plugins.hardware.marlin_applicator import open_applicator

SPEED = 40 / 60
TABLE = {"driver": "marlin-applicator", "centre_mm": [55.0, 52.0], "hover_height_mm": 32.0, "timeout_s": 0.4}


def linked(station, **more):
    one = station.open("applicator", open_applicator, **more)
    station.force = WorldForce(station.rig)
    one.link({"force": station.force})
    return one


def took(station, what, *arguments):
    before = station.clock.now()
    what(*arguments)
    return station.clock.now() - before


def until_it_moves(head):
    """A command without an answer is heard some time later; one that changes nothing never shows."""
    patience = threading.Event()
    for _ in range(50):
        if head.moving:
            return
        patience.wait(0.02)
