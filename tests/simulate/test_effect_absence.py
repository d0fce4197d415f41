"""What is off is not there: no import, no number; and what is on draws the same numbers whatever else is on."""

import inspect
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import combinations

import numpy as np
import pytest
from effect_options import REQUIRED
from simulated_setting import HEAD, held, installed, material, scene, sensor_type, world

from cbsr_qa.config.loader import load_scene
from cbsr_qa.domain.plan.world import Moment, SceneSetting, SheetDesign, Transcript
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.chain import STAGES, build_chain
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa_plugins.registry import BUILT_IN

SETTING = SceneSetting(sensor_type(), material(), HEAD, seed=7, current_A=4e-4)
PATTERN = sensor_type().pattern

# --- imports ---

_SESSION = """
import json, sys
from cbsr_qa.station.setup import configure, open_station
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.plugin.discovery import discover

configuration = configure("simulated", "nine-locations", sensor_type=None, material=None, seed=1)
bench = open_station(configuration, discover(), VirtualClock())
bench.force_applicator.find_surface(0.0, 0.0)
bench.force_applicator.press(0.8, 0.5)
bench.frame_source.acquire(2)
bench.close()
print(json.dumps([m for m in sys.modules if m.startswith("cbsr_qa_plugins.effects.")]))
"""


def modules_of(names: set[str]) -> set[str]:
    targets = {name: target for kind, name, target in BUILT_IN if kind is Kind.EFFECT}
    return {f"cbsr_qa_plugins.{targets[name].split(':')[0]}" for name in names}


@pytest.mark.rest
def test_a_run_on_the_shipped_station_imports_the_effects_of_its_scene_and_no_other():
    done = subprocess.run([sys.executable, "-c", _SESSION], capture_output=True, text=True, check=True)
    imported = {module for module in json.loads(done.stdout) if not module.rpartition(".")[2].startswith("_")}
    assert imported == modules_of({choice.name for choice in load_scene("base").value.effects})


# --- numbers ---

#: Every effect that draws; what it loses or dumps comes within the few frames of these tests.
RANDOM = {
    name: REQUIRED.get(name, {})
    for name in (
        *("uneven-conductance", "uneven-response", "batch-pattern", "uneven-thickness", "contact-spread"),
        "pin-position-error",
        *("applicator-position-error", "sheet-seat", "contact-drift", "electrode-intermittent"),
        *("measurement-noise", "electrode-noise", "johnson-noise", "mains-hum", "load-cell-noise"),
    )
} | {"frame-loss": {"share": 0.5}, "watchdog-dump": {"period_s": 1.0}}
NOT_RANDOM = ("time-skew", "source-compliance")  # needed by some of them
INSTALLED = [name for kind, name, _ in BUILT_IN if kind is Kind.EFFECT]
DRAWING = [name for name in RANDOM if name in INSTALLED]


@contextmanager
def spied(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, list[bytes]]]:
    """What is drawn from each stream, in order: index and numbers."""
    drawn: dict[str, list[bytes]] = {}
    begin, normal, generator = RandomStream.__init__, RandomStream.normal, RandomStream.generator

    def begun(self, seed, name):
        begin(self, seed, name)
        self.spied = drawn.setdefault(name, [])

    def drew(self, index, shape=()):
        numbers = normal(self, index, shape)
        self.spied.append(f"{index}".encode() + numbers.tobytes())
        return numbers

    def began(self, index):
        self.spied.append(f"{index}".encode() + generator(self, index).standard_normal(8).tobytes())
        return generator(self, index)

    with monkeypatch.context() as patch:
        patch.setattr(RandomStream, "__init__", begun)
        patch.setattr(RandomStream, "normal", drew)
        patch.setattr(RandomStream, "generator", began)
        yield drawn


def gone_through(names: list[str]) -> None:
    """Every stage of a few moments."""
    parameters = {name.replace("-", "_"): options for name, options in RANDOM.items()}
    chain = build_chain(scene(*NOT_RANDOM, *names, **parameters), SETTING, installed)
    chain.design(SheetDesign.make_uniform(sensor_type(), HEAD))
    chain.record(Transcript.complete(SETTING, 2.5 * np.arange(4)))
    for index in (0, 3, 1 << 33):
        moment = Moment(SETTING, 2.5 * (index % 32), index, [], [], [], reading_scale_V=1.0)
        moment.voltages, moment.flags = np.zeros(PATTERN.shape), np.zeros(PATTERN.shape, dtype=np.uint8)
        moment.impedance_ohm, moment.contact_mm = 1e4 * np.eye(16), np.full(16, 0.2)
        moment.current_A, moment.drive_ohm, moment.measure_ohm = (np.full(PATTERN.shape, x) for x in (4e-4, 2e4, 2e4))
        for stage in STAGES[1:-1]:
            chain.apply(stage, moment)


def test_the_list_of_effects_that_draw_is_whole(monkeypatch: pytest.MonkeyPatch):
    with spied(monkeypatch) as drawn:
        gone_through(DRAWING)
    assert set(drawn) == set(DRAWING)
    assert all(drawn.values())
    code = {name: target for kind, name, target in BUILT_IN if kind is Kind.EFFECT}
    using = {name for name in code if _uses_streams(installed(name))}
    assert using == set(DRAWING)


def _uses_streams(effect: type) -> bool:
    own = (one for one in effect.__mro__ if one.__module__.startswith("cbsr_qa_plugins"))
    return any("RandomStream" in inspect.getsource(one) for one in own)


@pytest.fixture(scope="module")
def with_all() -> dict[str, list[bytes]]:
    """What is drawn with every effect."""
    with pytest.MonkeyPatch.context() as patch, spied(patch) as drawn:
        gone_through(DRAWING)
    return drawn


@pytest.mark.parametrize("name", DRAWING)
def test_an_effect_more_leaves_every_other_stream_as_it_is(
    name: str, with_all: dict[str, list[bytes]], monkeypatch: pytest.MonkeyPatch
):
    with spied(monkeypatch) as without:
        gone_through([other for other in DRAWING if other != name])
    assert name not in without
    assert without == {other: numbers for other, numbers in with_all.items() if other != name}


# --- sums ---

#: Effects that add to readings what does not depend on these.
ADDING = ("measurement-noise", "electrode-noise", "johnson-noise", "mains-hum", "reading-offset")


@pytest.fixture(scope="module")
def sheet() -> SimulatedSheet:
    return world(scene()).sheet


def readings(sheet: SimulatedSheet, *names: str, time_s: float = 11.25, index: int = 9):
    parameters = {name.replace("-", "_"): options for name, options in RANDOM.items()}
    of = scene("time-skew", *names, **parameters, reading_offset={"offset_V": 0.02})
    here = SimulatedWorld(of, sensor_type(), material(), HEAD, seed=7, effect_factory=installed, sheet=sheet)
    return here.frame(time_s, index).voltages


@pytest.mark.parametrize(("one", "other"), list(combinations(ADDING, 2)))
def test_an_effect_adds_the_same_whether_another_is_on_or_not(one: str, other: str, sheet: SimulatedSheet):
    none, both = readings(sheet), readings(sheet, one, other)
    alone, beside = readings(sheet, one) - none, both - readings(sheet, other)
    assert np.abs(alone).max() > 0
    np.testing.assert_allclose(beside, alone, rtol=0, atol=4 * np.spacing(np.abs(both).max()))


def test_with_no_effect_on_readings_are_the_models_times_the_current_at_any_time(sheet: SimulatedSheet):
    here = world(scene())
    expected = here.sheet.unit_model.voltages() / here.sheet.conductance_S * here.setting.current_A
    first = here.voltages_V(0.0, 0)
    np.testing.assert_allclose(first, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    here.presses.append(held(0, 10.0, 0.0, 0.2, start_s=5.0))
    for time_s, index in ((1.25, 1), (5.6, 4), (3600.0, 2880), (1e7, 1 << 40)):
        frame = here.frame(time_s, index)
        np.testing.assert_array_equal(frame.voltages, first)
        assert not frame.flags.any()
        assert frame.time_s is None
