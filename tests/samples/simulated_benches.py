"""Simulated benches of the base scene and of others, opened for tests of them."""

from dataclasses import replace

from simulated_setting import base_scene, context

from cbsr_qa.domain.plan.plan import PluginChoice, Scene
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench, open_bench

SPEED = 40 / 60


def opened(of=None, **more) -> tuple[VirtualClock, SimulatedBench]:
    clock = more.pop("clock", None) or VirtualClock()
    return clock, open_bench(context(of or base_scene(), clock=clock, **more))


def lying(error_mm: float | None) -> Scene:
    """The base scene with the sheet off nominal by this much; None for a sheet that lies flat."""
    others = tuple(effect for effect in base_scene().effects if effect.name != "sheet-seat")
    seat = () if error_mm is None else (PluginChoice("sheet-seat", {"error_mm": error_mm}),)
    return replace(base_scene(), effects=(*seat, *others))
