"""Strips on the simulated bench, through sequence, runner and analysis: known truth, and what goes wrong."""

from dataclasses import replace

import numpy as np
import pytest
from strip_bench import strip_run

from cbsr_qa.analysis.strip_cycles import characterise_run, strip_force
from cbsr_qa.analysis.strip_measurements import measure_characterisation
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import ReadingFlag, SampleBlock
from cbsr_qa.domain.results.characterisation import STRIP_MEASURES
from cbsr_qa.domain.sensor.sensor_type import Response

SETTINGS = CharacterisationSettings()


@pytest.fixture(scope="module")
def run():
    return strip_run()


@pytest.fixture(scope="module")
def found(run):
    return characterise_run(run, SETTINGS)


def with_frames(run, change):
    """The run with other frames in its phase."""
    (phase,) = run.phases
    return replace(run, phases=(replace(phase, frames=change(phase.frames)),))


def with_force(run, change):
    """The run with another force in its phase."""
    (phase,) = run.phases
    (samples,) = phase.samples
    return replace(run, phases=(replace(phase, samples=(replace(samples, values=change(samples.values)),)),))


@pytest.mark.rest
def test_the_scenes_gauge_factor_and_modulus_come_out_with_the_bench_noise_on(found):
    """Seat, noise, relaxation and residue on; the analysis has another mesh and knows nothing of the scene."""
    assert found.local_against_strain.line.slope.value == pytest.approx(0.6, rel=0.03)
    assert found.local_against_stress.line.slope.value == pytest.approx(0.6 / 132.5, rel=0.03)
    assert found.modulus_kPa.value == pytest.approx(132.5, rel=0.02)
    assert abs(found.strain_offset.value) < 0.0125  # one step of the surface search
    assert found.response is Response.INCREASE
    assert found.strip.resistance_ohm.value == pytest.approx(18_100, rel=1e-3)
    assert found.strip.relative_noise == pytest.approx(7.9e-4, rel=0.35)
    assert [level.cycles for level in found.levels] == [3, 3, 3]


def test_measurements_have_the_units_that_are_promised(found):
    measured = measure_characterisation(found)
    assert {m.name for m in measured} <= set(STRIP_MEASURES)
    assert all(m.unit == STRIP_MEASURES[m.name] for m in measured)
    assert all(m.value is not None or m.how for m in measured)
    keys = [(m.name, m.qualifier) for m in measured]
    assert len(set(keys)) == len(keys)
    by_name = {(m.name, m.qualifier): m.value for m in measured}
    assert by_name["cycles_used", ""] == 9
    assert by_name["interelectrode_resistance", ""] / by_name["sheet_resistance", ""] == pytest.approx(
        found.strip.squares
    )
    # As they were read, changes from before the press lack what had not yet come; from rest they have what was left.
    before = by_name["gauge_factor", "end of hold, from before the press"]
    assert before < by_name["gauge_factor", ""]


@pytest.mark.rest
def test_contacts_other_than_assumed_are_within_the_stated_error():
    """Contacts half as large again are one standard error, and hide 4 % of the gauge factor."""
    effects = [("contact-spread", {"deviation": 0.01, "contact_mm": 0.3})]
    line = characterise_run(strip_run(effects=effects, cycles=2), SETTINGS).local_against_strain.line
    assert 0.94 < line.slope.value / 0.6 < 0.98
    assert abs(line.slope.value - 0.6) < 2 * line.slope.stderr


@pytest.mark.rest
def test_shuffled_strains_come_to_the_same():
    run = strip_run(order="shuffled", cycles=2, seed=5)
    pressed = [load.load.strain for load in run.phases[0].loads]
    assert pressed != sorted(pressed)
    assert pressed[0::2] == pressed[1::2]  # the cycles of a strain in a row
    assert characterise_run(run, SETTINGS).local_against_strain.line.slope.value == pytest.approx(0.6, rel=0.05)


# --- bad input ---


@pytest.mark.rest
def test_a_dead_pin_is_refused():
    effects = [("source-compliance", {"limit_V": 20.0}), ("electrode-open", {"electrode": 1})]
    with pytest.raises(AssertionError, match="rule 'compliance': 1 of 1 readings of a frame"):  # the station stops it
        strip_run(effects=effects, strains_percent=[10.0, 20.0], cycles=1)
    run = strip_run(effects=effects, strains_percent=[10.0, 20.0], cycles=1, compliance=np.inf)
    with pytest.raises(NumericsError, match="a pin may be open") as refused:
        characterise_run(run, SETTINGS)
    assert "check both pins" in refused.value.remedy


def test_readings_that_never_move_are_refused(run):
    stuck = with_frames(run, lambda frames: replace(frames, voltages=np.full_like(frames.voltages, 18.1)))
    with pytest.raises(NumericsError, match="all readings between the pins are stuck at 18100 Ω"):
        characterise_run(stuck, SETTINGS)
    turned = with_frames(run, lambda frames: replace(frames, voltages=-frames.voltages))
    with pytest.raises(NumericsError, match="resistances between the pins are not positive"):
        characterise_run(turned, SETTINGS)


def test_without_readings_of_the_rested_strip_there_is_no_change(run):
    first = run.phases[0].loads[0].press_start_s

    def lost(frames):
        flags = np.where(frames.time_s < first, np.uint8(ReadingFlag.MISSING), np.uint8(0))[:, None, None]
        return replace(frames, flags=flags)

    with pytest.raises(NumericsError, match="no usable reading of the rested strip"):
        characterise_run(with_frames(run, lost), SETTINGS)


@pytest.mark.rest
def test_a_cycle_that_was_not_read_is_left_out_by_name(run):
    load = run.phases[0].loads[4]

    def missing(frames):
        flags = frames.flags.copy()
        flags[(frames.time_s > load.hold_start_s) & (frames.time_s < load.release_start_s)] = ReadingFlag.MISSING
        return replace(frames, flags=flags)

    found = characterise_run(with_frames(run, missing), SETTINGS)
    assert sum(level.cycles for level in found.levels) == 8
    assert "left out: cycle 2 of 20 % strain has 0 usable readings of its hold and 60 of its rest" in found.reduced[0]
    assert found.local_against_strain.line.slope.value == pytest.approx(0.6, rel=0.04)
    counts = {m.name: (m.value, m.how) for m in measure_characterisation(found) if m.name.startswith("cycles")}
    assert counts["cycles_used"][0] == 8
    assert counts["cycles_excluded"] == (1, found.unread[0])


@pytest.mark.rest
def test_a_load_cell_at_its_limit_costs_the_strains_it_could_not_follow(run):
    """At 12 N: 20 % relaxes to 10.6 N after a peak of 13.2 N, 30 % to 15.9 N."""
    found = characterise_run(with_force(run, lambda force: np.minimum(force, 12.0)), SETTINGS)
    assert "the load cell is flat at its limit of 12 N: the stress at 30 % strain is unknown" in found.reduced
    assert [level.stress_kPa is None for level in found.levels] == [False, False, True]
    assert found.modulus_kPa.value == pytest.approx(132.5, rel=0.02)
    assert found.local_against_strain.line.slope.value == pytest.approx(0.6, rel=0.03)
    assert found.refused == ()


@pytest.mark.rest
def test_a_load_cell_that_ends_below_all_is_no_material(run):
    found = characterise_run(with_force(run, lambda force: np.minimum(force, 2.0)), SETTINGS)
    assert found.modulus_kPa is None
    assert any(why.startswith("no line against stress") for why in found.refused)
    (modulus,) = [m for m in measure_characterisation(found) if m.name == "compressive_modulus"]
    assert modulus.value is None
    assert "no modulus" in modulus.how


def test_a_force_without_noise_is_not_taken_for_a_limit():
    time_s = np.arange(0.0, 400.0, 0.125)
    run = strip_run(without=["load-cell-noise", "stress-relaxation"], strains_percent=[10.0, 20.0], cycles=1)
    (phase,) = run.phases
    assert strip_force(phase, 400.0).limit_N is None
    flat = SampleBlock("force", "N", time_s, np.zeros_like(time_s))
    assert strip_force(replace(phase, samples=(flat,)), 400.0).limit_N is None


@pytest.mark.rest
def test_holds_too_short_for_a_steady_level_are_no_material():
    """Twenty seconds of a creep of 23 s: its end cannot be told, and no residue explains what is left."""
    found = characterise_run(strip_run(hold_s=20.0, rest_s=20.0), SETTINGS)
    assert any("holds and rests are too short for steady levels" in why for why in found.refused)
    error = next(m for m in measure_characterisation(found) if m.name == "gauge_factor_error")
    assert (error.value, error.how) == (None, found.refused[0])
    assert any("holds of 19.5 s are shorter than 1.5 settling times of conductance" in why for why in found.reduced)


@pytest.mark.rest
def test_a_spike_after_the_release_moves_nothing_but_what_it_covers():
    found = characterise_run(strip_run(effects=[("unloading-spike", {"size": 0.3, "decay_s": 1.5})]), SETTINGS)
    assert found.local_against_strain.line.slope.value == pytest.approx(0.6, rel=0.03)
    assert found.unloading.time_constants_s[1] == pytest.approx(25.4, rel=0.1)


@pytest.mark.rest
def test_a_run_without_force_says_so(run):
    (phase,) = run.phases
    found = characterise_run(replace(run, phases=(replace(phase, samples=()),)), SETTINGS)
    assert found.reduced[0] == "no force was recorded: the stress is unknown"
    assert found.refused


def test_loads_of_another_purpose_are_no_cycles(run):
    (phase,) = run.phases
    with pytest.raises(NumericsError, match="no press cycles to characterise from"):
        characterise_run(replace(run, phases=(replace(phase, role=Role.GRID),)), SETTINGS)
    elsewhere = replace(phase.loads[0], load=replace(phase.loads[0].load, x_mm=1.0))
    moved = replace(phase, loads=(elsewhere, *phase.loads[1:]))
    with pytest.raises(NumericsError, match="pressed at 2 places"):
        characterise_run(replace(run, phases=(moved,)), SETTINGS)
    with pytest.raises(NumericsError, match="'disc-100mm' is not a strip"):
        characterise_run(replace(run, sensor_type=load_sensor_type("disc-100mm").value), SETTINGS)
