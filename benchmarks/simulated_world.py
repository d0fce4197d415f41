"""The simulated world: what scenes cost, and what their speed costs in accuracy."""

import multiprocessing
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare, fastest, shown, whole_command
from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.plan.scene_plan import SceneLoad
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.loads.family import LoadFamily
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.simulate.recording import record_scene
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.studies.scenes.setting import SceneSetup, make_world, set_up

TITLE = "Simulated world"

Array = NDArray[np.float64]
_REPEATS: Final = 5
#: The paper's campaign: nine locations, six strains, three trials, a press cycle of 120 s.
_STRAINS: Final = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
_TRIALS: Final = 3
_CYCLE_S, _HOLD_S = 120.0, 60.0
_RUNS: Final = ("everything", "base")
_MATERIALS: Final = ("cbsr-8wt", "cbsr-9wt")


def rows() -> Iterator[Row]:
    """The nine-location run, the campaign, and frames compared with solving each again."""
    everything, base = (fastest(lambda name=name: _recorded(set_up(name, recorded=True)), _REPEATS) for name in _RUNS)
    run = "nine locations, 18 min of station time, 432 frames and 8641 force samples, meshing included"
    yield Row(f"{run}: scene `everything`", "≤ 3 s", shown(everything), met=everything <= 3)
    yield Row(
        f"{run}: scene `base`",
        "at least 3 × less",
        f"{shown(base)}, {everything / base:.1f} × less",
        met=everything >= 3 * base,
    )
    yield _command()
    for scene, goal in (("base", None), ("everything", 90.0)):
        yield _campaign(scene, goal)
    yield _frame()


def _recorded(setup: SceneSetup) -> None:
    record_scene(_world(setup), setup.plan)


def _world(setup: SceneSetup) -> SimulatedWorld:
    return make_world(setup, partial(discover().factory, Kind.EFFECT), seed=setup.plan.seed or 0)


def _command() -> Row:
    """The whole command, from the shell to the file, and the most memory it takes."""
    program = str(Path(sys.executable).with_name("cbsr-qa"))
    with TemporaryDirectory() as folder:
        command = [program, "scene", "run", "everything", "--output", str(Path(folder) / "everything.h5")]
        seconds, megabytes = whole_command(command)
    said = f"{shown(seconds)} with the program's start and the file, {megabytes:.0f} MB at most"
    return Row("`cbsr-qa scene run everything`", "≤ 400 MB", said, met=megabytes <= 400)


def campaign(scene: str, material: str) -> float:
    """Simulate the paper's campaign on one material, and return how long it took [s]."""
    before = time.perf_counter()
    setup = set_up(scene, recorded=True)
    setup = replace(setup, material=load_material(material))
    places = [(place, strain) for place in NINE_LOCATIONS_MM for strain in _STRAINS for _ in range(_TRIALS)]
    loads = tuple(
        SceneLoad(x_mm, y_mm, strain, 20.0 + _CYCLE_S * number, _HOLD_S)
        for number, ((x_mm, y_mm), strain) in enumerate(places)
    )
    plan = replace(setup.plan, loads=loads, duration_s=_CYCLE_S * len(loads))
    record_scene(_world(setup), plan)
    return time.perf_counter() - before


def _campaign(scene: str, goal: float | None) -> Row:
    before = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        each = pool.starmap(campaign, [(scene, material) for material in _MATERIALS])
    seconds = time.perf_counter() - before
    what = f"campaign: 9 locations × 6 strains × 3 trials × 2 materials, 10.8 h, 15552 frames, scene `{scene}`"
    here = f"{seconds:.0f} s on 2 cores ({each[0]:.0f} and {each[1]:.0f} s)"
    met = None if goal is None else seconds <= goal
    return Row(what, "" if goal is None else f"≤ {goal:g} s", here, met=met)


def _frame() -> Row:
    """Nine loads whose strengths change from frame to frame, against factorising the sheet for each."""
    sheet = _base_sheet()
    families = [sheet.load_at(place) for place in NINE_LOCATIONS_MM]
    strengths = np.random.default_rng(0).uniform(-0.05, 0.2, (64, 9))
    turn = iter(range(1 << 30))

    def loads() -> dict[LoadFamily, float]:
        return dict(zip(families, strengths[next(turn) % 64].tolist(), strict=True))

    def factorised(changed: dict[LoadFamily, float]) -> Array:
        elements = np.concatenate([family.elements for family in changed])
        change = np.concatenate([family.change(strength) for family, strength in changed.items()])
        return sheet.unit_model.with_change_on(elements, change).voltages() / sheet.conductance_S

    def tabulated(changed: dict[LoadFamily, float]) -> Array:
        places = dict(zip(NINE_LOCATIONS_MM, changed.values(), strict=True))
        return sheet.voltages(places)

    some = loads()
    exact = factorised(some)
    error = np.abs(tabulated(some) - exact).max() / np.abs(exact[sheet.sensor_type.pattern.usable()]).mean()
    compared = compare(
        f"a frame of nine loads of other strengths, {len(sheet.mesh.elements)} elements of second order"
        f" (right to {error:.0e} of the mean reading)",
        ("tabulated loads", lambda: tabulated(loads())),
        ("factorising again", lambda: factorised(loads())),
        _REPEATS,
        burst=8,
    )
    return ratio_row(compared)


@lru_cache
def _base_sheet() -> SimulatedSheet:
    return _world(set_up("base", recorded=True)).sheet
