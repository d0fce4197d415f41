"""Data-sheet metrics on observations made by hand: values that follow, and reasons where none does."""

from dataclasses import replace

import numpy as np
import pytest
from observation_samples import INDENTER, sample_load, sample_relaxation, sample_run

from cbsr_qa.calibration.sheet.characteristic import characteristics, data_sheet_loads, mean_characteristic
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa_plugins.metrics.data_sheet import Creep, Nonlinearity, PreconditioningChange, Repeatability, ZeroReturn
from cbsr_qa_plugins.metrics.mechanics import ApparentModulus, Uniformity
from cbsr_qa_plugins.metrics.relaxation import SettlingTimes

ALL = (Repeatability, Nonlinearity, Creep, ZeroReturn, Uniformity, ApparentModulus, PreconditioningChange)
STRAINS = (0.05, 0.1, 0.15, 0.2, 0.25)


def pressed(label, strain, change, *, kPa=132.5, trial=0, index=0, phase="grid", **more):
    """A press at a place of its own by label, whose stress is ``kPa`` times the strain."""
    force_N = None if kPa is None else kPa * strain * INDENTER.area_mm2 * 1e-3
    place = (5.0 * int(label[1:]), 0.0)
    load = sample_load(label, place, change=change, force_N=force_N, trial=trial, phase=phase, index=index, **more)
    record = replace(load.record, load=replace(load.record.load, strain=strain))
    return replace(load, record=record)


def grid(change_at, *, labels=("L0", "L1"), trials=1, **more):
    """Every label at every strain; ``change_at(label, strain, trial)``."""
    wanted = [(label, s, t) for s in STRAINS for t in range(trials) for label in labels]
    return tuple(
        pressed(label, s, change_at(label, s, t), trial=t, index=k, **more) for k, (label, s, t) in enumerate(wanted)
    )


def one(metric, run, qualifier=""):
    return next(m for m in metric.measure_run(run) if m.qualifier == qualifier and not m.location)


def with_role(run, role):
    record = replace(run.record, phases=tuple(replace(phase, role=role) for phase in run.record.phases))
    return replace(run, record=record)


def traces(load, **values):
    """The load with traces of one sample a second for 60 s: ``conductance``, ``stress``, ``rest``."""
    time_s, seen = np.arange(60.0) + 0.5, []
    for name, at in values.items():
        signal, loading = ("conductance", False) if name == "rest" else (name, True)
        relaxation = sample_relaxation(20.0, signal=signal, loading=loading)
        seen.append(replace(relaxation, trace=replace(relaxation.trace, time_s=time_s, values=at(time_s))))
    return replace(load, relaxations=tuple(seen))


# --- repeatability -------------------------------------------------------------------------------------------


def test_repeatability_is_the_scatter_of_trials_in_shares_of_each_places_span():
    """Places of different gain scatter alike relative to their span: 1 % up and down about the mean."""
    gain = {"L0": 0.2, "L1": 0.4}

    def change(label, strain, trial):
        return gain[label] * (strain + (0.25 * 0.01 if trial else -0.25 * 0.01))

    run = sample_run(grid(change, trials=2))
    found = one(Repeatability(), run)
    assert found.value == pytest.approx(np.sqrt(2) * 1.0)  # deviation of ± 1 % from two trials
    assert found.uncertainty == pytest.approx(found.value / np.sqrt(2 * 10))
    by_strain = [m for m in Repeatability().measure_run(run) if m.qualifier]
    assert [m.qualifier for m in by_strain] == [f"{percent} % strain" for percent in (5, 10, 15, 20, 25)]
    assert [m.value for m in by_strain] == pytest.approx([np.sqrt(2)] * 5)


def test_trials_are_compared_within_their_phase():
    """A drift between phases is no scatter of trials."""
    early = [pressed("L0", 0.2, 0.03, trial=t, index=t, phase="noise") for t in range(2)]
    late = [pressed("L0", 0.2, 0.05, trial=t, index=t, phase="grid") for t in range(2)]
    assert one(Repeatability(), sample_run((*early, *late))).value == pytest.approx(0.0, abs=1e-12)


def test_one_trial_has_no_repeatability():
    found = one(Repeatability(), sample_run(grid(lambda _, strain, __: strain)))
    assert (found.value, found.unit) == (None, "%")


# --- nonlinearity --------------------------------------------------------------------------------------------


def test_nonlinearity_of_a_parabola():
    """c = σ + b σ²: an eighth and a quarter of b (σ₅ − σ₁)² from the best line and from the chord."""
    kPa, bend = 132.5, 2.0
    run = sample_run(grid(lambda label, s, _: (1 + (label == "L1")) * (s + bend * s**2)))
    span = STRAINS[-1] + bend * STRAINS[-1] ** 2
    best, chord = (one(Nonlinearity(), run, q) for q in ("", "terminal-based"))
    assert best.value == pytest.approx(100 * bend * 0.2**2 / 8 / span)
    assert chord.value == pytest.approx(100 * bend * 0.2**2 / 4 / span)
    assert best.uncertainty is None  # one trial: nobody knows the scatter
    each = {m.location: m.value for m in Nonlinearity().measure_run(run) if m.location}
    assert each == {"L0": pytest.approx(best.value), "L1": pytest.approx(best.value)}
    mean = mean_characteristic(characteristics(data_sheet_loads(run), run.main_mask))
    assert mean.stress_kPa == pytest.approx(kPa * np.array(STRAINS))
    assert mean.span == pytest.approx(1.0)


def test_the_scatter_of_trials_is_the_nonlinearitys_uncertainty():
    rng = np.random.default_rng(3)
    run = sample_run(grid(lambda _, s, __: s + 0.002 * rng.standard_normal(), trials=3))
    found = one(Nonlinearity(), run)
    scatter = one(Repeatability(), run).value / np.sqrt(6)  # of a mean over 2 places and 3 trials
    assert 0.5 * scatter / np.sqrt(2) < found.uncertainty < scatter
    assert found.value < 3 * scatter


@pytest.mark.parametrize(
    ("strains", "kPa", "said"),
    [((0.2,), 132.5, "there are 1"), ((0.1, 0.2), 132.5, "there are 2"), (STRAINS, None, "no force was recorded")],
)
def test_without_strains_or_force_there_is_no_nonlinearity(strains, kPa, said):
    loads = tuple(pressed("L0", s, s, kPa=kPa, index=k) for k, s in enumerate(strains))
    found = one(Nonlinearity(), sample_run(loads))
    assert found.value is None
    assert said in found.how


def test_strains_at_which_the_load_cell_stood_at_its_limit_are_left_out():
    """The highest strain has no force: the line goes through the four others, whose highest is then the span."""
    bend, loads = 2.0, grid(lambda _, s, __: s + 2.0 * s**2)
    lost = tuple(
        replace(load, force_N=None, no_force="the load cell stood at its limit of 4 N")
        if load.record.load.strain == STRAINS[-1]
        else load
        for load in loads
    )
    found = one(Nonlinearity(), sample_run(lost))
    assert found.value == pytest.approx(
        100 * bend * 0.05**2 / (0.2 + bend * 0.2**2)
    )  # of 4 points: 1.5² to 0.5², halved
    assert "4 strains from 5 to 20 %" in found.how
    none = tuple(replace(load, force_N=None, no_force="the load cell stood at its limit of 4 N") for load in loads)
    for metric in (Nonlinearity(), ApparentModulus()):
        refused = one(metric, sample_run(none))
        assert refused.value is None
        assert "stood at its limit of 4 N" in refused.how


# --- creep and zero return -----------------------------------------------------------------------------------


def creeping(level, *, stress=True, rest=0.02):
    def conductance(t):
        return level * (1 - 0.5 * np.exp(-t / 20))

    def relaxing(t):
        return 26.0 * (1 + 0.1 * np.exp(-t / 15))

    more = {"stress": relaxing} if stress else {}
    return traces(
        pressed("L0", 0.2, level, index=int(100 * level)),
        conductance=conductance,
        rest=lambda t: np.full_like(t, rest * level),
        **more,
    )


def test_creep_is_counted_from_its_time_to_the_last_frames_and_without_the_stresss_own():
    run = sample_run((creeping(0.03), creeping(0.06)))
    time_s = np.arange(56, 60) + 0.5

    def share(weight, tau):
        end = 1 + weight * np.exp(-time_s / tau).mean()
        return 100 * (end - 1 - weight * np.exp(-5.0 / tau)) / end

    seen, of_stress, own = (one(Creep(), run, q) for q in ("conductance", "stress", ""))
    assert seen.value == pytest.approx(share(-0.5, 20), abs=0.02)  # linear between samples
    assert of_stress.value == pytest.approx(share(0.1, 15), abs=0.02)
    assert own.value == pytest.approx(seen.value - of_stress.value)
    assert seen.uncertainty == pytest.approx(0.0, abs=1e-9)  # both loads creep alike
    later = one(Creep(from_s=30.0), run, "conductance")
    assert 0 < later.value < seen.value


def test_creep_without_force_is_of_the_conductance_alone():
    run = sample_run((creeping(0.03, stress=False),))
    assert one(Creep(), run, "conductance").value > 0
    assert [one(Creep(), run, q).value for q in ("", "stress")] == [None, None]


def test_a_cell_at_its_limit_says_nothing_about_the_stress():
    """Its samples are there, flat; the load's force is not known."""
    load = replace(creeping(0.03), force_N=None, force_stderr_N=None)
    assert one(Creep(), sample_run((load,)), "stress").value is None
    both = one(Creep(), sample_run((load, creeping(0.06))), "stress")
    assert both.value == one(Creep(), sample_run((creeping(0.06),)), "stress").value


def test_creep_needs_a_hold_longer_than_its_beginning():
    found = one(Creep(from_s=58.0), sample_run((creeping(0.03),)))
    assert found.value is None
    with pytest.raises(ConfigError, match="from_s is 0"):
        Creep(from_s=0)


def test_zero_return_weighs_presses_by_their_change():
    run = sample_run((creeping(0.03, rest=0.10), creeping(0.06, rest=0.04)))
    held = 1 - 0.5 * np.exp(-(np.arange(56, 60) + 0.5) / 20).mean()
    found = one(ZeroReturn(), run)
    assert found.value == pytest.approx(100 * (0.03 * 0.10 + 0.06 * 0.04) / (0.09 * held))
    assert found.uncertainty > 0
    assert one(ZeroReturn(), sample_run((pressed("L0", 0.2, 0.03),))).value is None


def test_holds_of_another_length_are_left_out():
    odd = creeping(0.05)
    odd = replace(odd, record=replace(odd.record, release_start_s=odd.record.release_start_s + 60))
    found = one(Creep(), sample_run((creeping(0.03), creeping(0.04), odd)))
    assert "end of 60 s; 2 holds" in found.how


# --- modulus -------------------------------------------------------------------------------------------------


def test_the_modulus_of_each_location_and_of_all():
    moduli = {"L0": 130.0, "L1": 134.0}
    loads = tuple(
        pressed(label, s, s, kPa=moduli[label], index=k)
        for k, (s, label) in enumerate((s, label) for s in STRAINS for label in moduli)
    )
    run = sample_run(loads)
    for qualifier in ("", "slope"):
        found = one(ApparentModulus(), run, qualifier)
        assert found.value == pytest.approx(132.0)
        assert found.uncertainty == pytest.approx(np.std([130, 134], ddof=1) / np.sqrt(2))
        each = [m for m in ApparentModulus().measure_run(run) if m.location and m.qualifier == qualifier]
        assert {m.location: m.value for m in each} == pytest.approx(moduli)


def test_a_contact_height_that_is_off_moves_the_ratio_and_not_the_slope():
    """All stresses are lower by 2 kPa: the head touched late."""
    loads = tuple(pressed("L0", s, s, kPa=(132.5 * s - 2.0) / s, index=k) for k, s in enumerate(STRAINS))
    run = sample_run(loads)
    assert one(ApparentModulus(), run).value < 125
    assert one(ApparentModulus(), run, "slope").value == pytest.approx(132.5)


def test_the_modulus_is_refused_without_force_and_its_slope_with_one_strain():
    none = one(ApparentModulus(), sample_run((pressed("L0", 0.2, 0.03, kPa=None),)))
    assert (none.value, none.unit) == (None, "kPa")
    single = sample_run((pressed("L0", 0.2, 0.03),))
    assert one(ApparentModulus(), single).value == pytest.approx(132.5)
    assert one(ApparentModulus(), single).uncertainty is None
    assert one(ApparentModulus(), single, "slope").value is None


# --- preconditioning -----------------------------------------------------------------------------------------


def test_preconditioning_says_what_its_last_cycle_changed():
    def cycle(trial):
        level = 0.04 - 0.01 * 0.5**trial
        load = pressed("L0", 0.3, level, kPa=140 - trial, trial=trial, index=trial, phase="worked in")
        return traces(load, conductance=lambda t: np.full_like(t, level))

    run = with_role(sample_run(tuple(cycle(t) for t in range(4))), Role.PRECONDITIONING)
    count = PreconditioningChange().measure_run(run)[0]
    assert (count.name, count.value) == ("preconditioning_cycles", 4.0)
    before, after = (0.04 - 0.01 * 0.5**t for t in (2, 3))
    found = next(m for m in PreconditioningChange().measure_run(run) if m.unit == "%" and not m.qualifier)
    assert found.value == pytest.approx(100 * (after - before) / after)
    assert found.how == "cycle 3 to cycle 4 at 30 % strain; 1 location"
    assert one(PreconditioningChange(), run, "stress").value == pytest.approx(-100 / 137)
    # What works the sheet in is no part of its data sheet.
    assert data_sheet_loads(run) == ()
    assert one(Repeatability(), run).value is None


# --- all -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("metric", ALL)
def test_a_run_without_nominal_loads_or_in_which_nothing_was_sensed_is_refused_with_the_reason(metric):
    elsewhere = tuple(replace(sample_load(f"R{k}", index=k), phase="random") for k in range(2))
    unseen = tuple(sample_load(f"L{k}", blob_mm=None, force_N=None, index=k) for k in range(3))
    for run in (with_role(sample_run(elsewhere), Role.RANDOM), sample_run(unseen)):
        found = metric().measure_run(run)
        assert found
        assert all(m.value is None and len(m.how) > 10 for m in found)
        assert {m.name for m in found} <= set(metric.measures)


def test_what_works_the_sheet_in_says_nothing_about_settling():
    long = replace(sample_load(), relaxations=(sample_relaxation(30.0),))
    short = replace(sample_load(phase="worked in"), relaxations=(sample_relaxation(2.0),))
    run = sample_run((short, long))
    first, second = run.record.phases
    record = replace(run.record, phases=(replace(first, role=Role.PRECONDITIONING), second))
    found = SettlingTimes().measure_run(replace(run, record=record))
    assert found[0].value == pytest.approx(30.0)
