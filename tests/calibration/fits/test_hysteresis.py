"""Hysteresis of simulated loops against what the simulated world was told, and what keeps it from being told."""

import tomllib
from dataclasses import replace
from functools import cache
from importlib.resources import files

import numpy as np
import pytest
from simulated_runs import observed_run, simulated_run
from tiers import rest_but

from cbsr_qa.analysis.run.force import run_force
from cbsr_qa.calibration.fits.hysteresis_fit import hysteresis, loop_curve
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import EasedStrain, Load, LoadRecord
from cbsr_qa.domain.results.observation import LoopObservation, Trace
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa_plugins.metrics.data_sheet import Hysteresis
from cbsr_qa_plugins.sequences.centre import HysteresisLoopSequence
from cbsr_qa_plugins.sequences.places import LocationGridSequence

_QUIET = 1e-6  # relative noise: what is left of a figure's error is the figure's own
_LAST_S = 10.0


def _scene(width):
    text = files("cbsr_qa._stations").joinpath("scenes", "base.toml").read_text()
    data = {key: value for key, value in tomllib.loads(text).items() if key in ("scene", "effects")}
    loop = [{"name": "hysteresis", "width": width}] if width else []
    return {**data, "effects": [*data["effects"], *loop]}


def _record(width, *, noise=_QUIET, before=(), seed=1, **options):
    loop = PlannedPhase("loop", "hysteresis-loop", HysteresisLoopSequence(**options))
    return simulated_run((), phases=(*before, loop), scene=_scene(width), noise=noise, seed=seed)


def _figures(run):
    return {m.qualifier: m for m in Hysteresis().measure_run(run) if not m.location}


# --- against the simulated truth -------------------------------------------------------------------------


_WIDTHS = rest_but({0.0, 0.1}, [0.0, 0.04, 0.1])  # none at all, and the widest, stay in make test


@cache
def _quiet(width):
    return observed_run(_record(width, cycles=1))


@pytest.mark.parametrize("width", _WIDTHS)
def test_the_loop_is_as_wide_as_the_world_was_told(width):
    """The effect's loop is widest half-way, at 15 of 30 %: by its width, of the change at the tip."""
    found = _figures(_quiet(width))[""]
    assert found.value == pytest.approx(100 * width, abs=0.3)
    assert found.uncertainty < 0.2


def test_the_branches_lie_apart_as_the_effects_parabola():
    """4 width x (1 − x) at the strains of the way down: three quarters of it at x = 3/4 and 1/4."""
    curve = loop_curve(_quiet(0.1).loops[0], relaxed=True, last_s=_LAST_S)
    assert curve.strain == pytest.approx([0.075, 0.15, 0.225, 0.3, 0.225, 0.15, 0.075])
    assert 100 * curve.difference == pytest.approx([7.5, 10.0, 7.5], abs=0.5)
    true_kPa = _quiet(0.1).record.material.modulus_kPa.value * curve.strain
    assert curve.stress_kPa == pytest.approx(true_kPa, rel=0.03)  # the head lies up to 0.05 mm off: the sheet's seat


@pytest.mark.parametrize("width", _WIDTHS)
def test_creep_passes_for_hysteresis_only_in_what_was_read(width):
    found = _figures(_quiet(width))
    assert found["as read"].value > found[""].value + 2.5
    assert found["as read"].value == pytest.approx(100 * width + 3.5, abs=0.3)  # what 60 s leave of the kernels


@pytest.mark.rest
@pytest.mark.parametrize("width", [0.0, 0.08])
def test_the_stated_error_covers_the_material_noise(width):
    found = _figures(observed_run(_record(width, noise=None, cycles=2, seed=4)))[""]
    assert 0.5 < found.uncertainty < 2.5
    assert found.value == pytest.approx(100 * width, abs=3 * found.uncertainty)


@pytest.mark.rest
def test_places_are_told_apart_and_averaged():
    run = observed_run(_record(0.08, cycles=1, locations_mm=[[0, 0], [20, 10]], rest_s=240))
    whole, *each = [m for m in Hysteresis().measure_run(run) if not m.qualifier]
    assert [m.location for m in each] == ["H0", "H1"]
    assert [m.value for m in (whole, *each)] == pytest.approx([8.0] * 3, abs=0.4)


@pytest.mark.rest
def test_an_electrode_that_falls_out_for_one_hold_and_one_that_drifts_cost_little():
    """Readings of 1 V on two electrodes in one hold, a drift as large as the load on another: 31 of 208 readings."""
    record = _record(0.1, cycles=2)
    phase = record.phases[0]
    held, frames = phase.loops[0].held[1], phase.frames
    voltages = frames.voltages.copy()
    gone = (frames.time_s >= held.start_s) & (frames.time_s < held.end_s)
    voltages[np.ix_(gone, range(16), [3, 4])] = 1.0
    answer = np.abs(voltages[frames.time_s > held.end_s].std(axis=0)).max()
    voltages[:, :, 12] += answer * np.linspace(0, 1, len(frames))[:, None]
    run = observed_run(replace(record, phases=(replace(phase, frames=replace(frames, voltages=voltages)),)))
    assert _figures(run)[""].value == pytest.approx(10.0, abs=1.0)


@pytest.mark.rest
def test_everything_at_once_leaves_the_loop_within_its_stated_error():
    """The shipped scene of every effect, its loop 5 % wide; to 20 % strain, since its load cell ends at 7.35 N."""
    text = files("cbsr_qa._stations").joinpath("scenes", "everything.toml").read_text()
    scene = {key: value for key, value in tomllib.loads(text).items() if key in ("scene", "effects")}
    (width,) = [effect["width"] for effect in scene["effects"] if effect["name"] == "hysteresis"]
    loop = HysteresisLoopSequence(strains_percent=[5, 10, 15, 20], cycles=3)
    record = simulated_run((), phases=(PlannedPhase("loop", "loop", loop),), scene=scene, seed=2)
    found = _figures(observed_run(record))[""]
    assert found.value == pytest.approx(100 * width, abs=2 * found.uncertainty)
    assert found.uncertainty < 5.0


# --- nothing else takes a loop for a press ---------------------------------------------------------------


@pytest.mark.rest
def test_loops_neither_calibrate_nor_test_force_nor_change_what_does():
    places = [[0, 0], [20, 0], [-10, 17.3], [-10, -17.3]]
    grid = PlannedPhase(
        "nine locations", "location-grid", LocationGridSequence(locations_mm=places, hold_s=30, rest_s=30)
    )
    record = _record(0.0, before=(grid,), cycles=1, initial_rest_s=60)
    assert [(len(phase.loads), len(phase.loops)) for phase in record.phases] == [(4, 0), (0, 1)]
    assert record.phases[1].role is Role.LOOP
    run = observed_run(record)
    bare = tuple(replace(phase, loops=()) for phase in record.phases)
    without = observed_run(replace(record, phases=bare))
    assert [load.record for load in run.loads] == [load.record for load in without.loads]
    assert run.tested == run.loads
    assert (
        run.response_how == without.response_how == "decided from 4 loads: 4 loads raise the conductance, 0 lower it"
    )
    force, bare_force = run_force(run), run_force(without)
    assert len(force.used) == 4
    assert force.tests == ()
    assert force.learned.ratio == pytest.approx(bare_force.learned.ratio)
    assert _figures(without)[""].value is None


def test_a_run_of_loops_alone_knows_which_way_its_sheet_responds():
    assert _quiet(0.0).loads == ()
    assert _quiet(0.0).response_how == "decided from 1 loads: 1 loads raise the conductance, 0 lower it"


# --- loops made by hand ----------------------------------------------------------------------------------

_HOLD_S, _FRAME_S = 60.0, 2.5


def _by_hand(
    strains=(0.1, 0.2, 0.3, 0.2, 0.1), *, output, holds_s=None, stress=lambda strain: 100 * strain, cycles=2
):
    """Loops whose output settles at once at ``output(k, strain)`` of the k-th strain."""
    records, time_s, values, kPa, start_s = [], [], [], [], 100.0
    for cycle in range(cycles):
        holds = []
        for k, strain in enumerate(strains):
            end_s = start_s + (holds_s[k] if holds_s else _HOLD_S)
            times = np.arange(start_s + _FRAME_S / 2, end_s, _FRAME_S)
            time_s += times.tolist()
            values += [output(k, strain)] * len(times)
            kPa += [stress(strain)] * len(times)
            holds.append((strain, start_s, end_s))
            start_s = end_s + 1.0
        eased = tuple(EasedStrain(strain, at_s - 1.0, at_s) for strain, at_s, _ in holds[1:])
        load = Load("H0", 0.0, 0.0, strains[0], cycle)
        end_s = holds[-1][2]
        records.append(
            LoadRecord(cycle, load, holds[0][1] - 1, holds[0][1], end_s, end_s + 1, end_s + 60, eased=eased)
        )
        start_s = end_s + 60.0
    times = np.array(time_s)
    trace, force = Trace("output", "1", times, np.array(values)), Trace("stress", "kPa", times, np.array(kPa))
    return LoopObservation("loop", tuple(records), trace, 1e-6, force)


@pytest.mark.parametrize(
    ("relaxed", "at", "strain", "off"), [(True, 3, 0.2, 0.06), (False, 3, 0.2, 0.06), (False, 4, 0.1, -0.06)]
)
def test_what_settles_at_once_is_read_exactly_on_a_way_back_above_or_below(relaxed, at, strain, off):
    loop = _by_hand(output=lambda k, strain: strain / 0.3 + (off if k == at else 0.0))
    found = hysteresis([loop_curve(loop, relaxed=relaxed, last_s=_LAST_S)])
    assert found.estimate.value == pytest.approx(0.06, abs=1e-9)
    assert (found.strain, found.higher) == (strain, off > 0)


def test_outputs_are_compared_at_the_stress_that_was_there():
    """A head that stops 5 % short on the way back (play): a straight characteristic shows no hysteresis for it."""

    def played(k, strain):
        return strain if k < 3 else 0.95 * strain

    loop = _by_hand(output=lambda k, strain: played(k, strain) / 0.3)
    short = np.array([100 * played(k % 5, s) for k, s in enumerate((0.1, 0.2, 0.3, 0.2, 0.1) * 2)])
    count = len(loop.stress.values) // len(short)
    loop = replace(loop, stress=replace(loop.stress, values=np.repeat(short, count)))
    curve = loop_curve(loop, relaxed=False, last_s=_LAST_S)
    assert curve.difference == pytest.approx([0.0, 0.0], abs=1e-12)


def test_scatter_of_the_cycles_is_in_the_error():
    drawn = np.random.default_rng(3).normal(0.0, 0.02, 100)
    loop = _by_hand(output=lambda k, strain: strain / 0.3, cycles=4)
    shifts = np.repeat(drawn[: 4 * 5], len(loop.output.values) // 20)
    loop = replace(loop, output=replace(loop.output, values=loop.output.values + shifts))
    curve = loop_curve(loop, relaxed=False, last_s=_LAST_S)
    assert (curve.stderr > 0.004).all()  # √2 · 0.02 / √4 expected, 3 degrees of freedom


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"strains": (0.1, 0.2, 0.3)}, "did not go up"),
        ({"strains": (0.3, 0.2, 0.1)}, "did not go up"),
        ({"strains": (0.1, 0.3, 0.2, 0.25)}, "did not go up"),
        ({"holds_s": (60, 60, 90, 60, 60)}, "held for 60 to 90 s: creep is not alike"),
        ({"holds_s": (15,) * 5}, "too few to tell creep"),
        ({"stress": lambda strain: 10.0}, "does not rise with the strain"),
    ],
)
def test_loops_that_tell_nothing_say_why(made, said):
    loop = _by_hand(output=lambda k, strain: strain / 0.3, **made)
    with pytest.raises(NumericsError, match=said):
        loop_curve(loop, relaxed=True, last_s=_LAST_S)


def test_drift_slower_than_the_holds_is_not_called_hysteresis():
    loop = _by_hand(output=lambda k, strain: strain / 0.3)
    wander = np.concatenate([np.linspace(0, 0.05, 24) for _ in range(10)])
    loop = replace(loop, output=replace(loop.output, values=loop.output.values + wander))
    with pytest.raises(NumericsError, match="creep cannot be separated from hysteresis"):
        loop_curve(loop, relaxed=True, last_s=_LAST_S)


def test_the_metric_says_what_is_missing():
    run = _quiet(0.1)
    (loop,) = run.loops
    for changed, said in (
        ((), "no strain was reached from below and from above"),
        ((replace(loop, stress=None),), "no force was recorded"),
        ((replace(loop, stress=None, no_force="the load cell stood at 4 N"),), "the load cell stood at 4 N"),
        ((replace(loop, why="no load stands out of the noise"),), "no load stands out of the noise"),
    ):
        found = _figures(replace(run, loops=changed))[""]
        assert found.value is None
        assert said in found.how


def test_a_load_cell_at_its_limit_while_the_deepest_strain_is_held_gives_no_force():
    record = _record(0.0, cycles=1)
    phase = record.phases[-1]
    (force,) = phase.samples
    clipped = replace(force, values=np.minimum(force.values, 0.9 * np.quantile(force.values, 0.99)))
    run = observed_run(replace(record, phases=(replace(phase, samples=(clipped,)),)))
    assert "it is saturated" in _figures(run)[""].how
