"""Place learned from a run's own presses: used where the sheet is not as modelled, left alone where it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_runs import observed_run, simulated_run

from cbsr_qa.analysis.evaluate import Conclusion, calibrate_run
from cbsr_qa.analysis.run.force import force_loads
from cbsr_qa.analysis.run.loads import window_of
from cbsr_qa.analysis.run.place import run_place
from cbsr_qa.calibration.file.hdf5 import read_calibration, write_calibration
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import CalibrationError, ConfigError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Indenter
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.studies.simulated import copy_shipped
from cbsr_qa_plugins.sequences.places import LocationGridSequence, RandomLoadsSequence

CALIBRATE = ("places",)
#: The 39 of the recipe ``campaign``.
PLACES_MM = [*NINE_LOCATIONS_MM, *copy_shipped(DocumentKind.RECIPE, "campaign")["phases"][2]["locations_mm"]]
#: Readings that keep half of the one before: no model of a sheet has that.
MEMORY = (("name", "reading-memory"), ("share", 0.5))
_HELD = {"hold_s": 40.0, "rest_s": 30.0, "find_surface": False}


@cache
def observed(effects=(), places=39):
    """A run of 39 places and ten random loads on a sheet with effects beside those of the scene ``base``.

    The loads of the first ``places`` are kept.
    """
    grid, random = recorded(effects).phases
    record = replace(recorded(effects), phases=(replace(grid, loads=grid.loads[:places]), random))
    return observed_run(record, over_time=False, calibrate_phases=CALIBRATE, learn_place=True)


@cache
def recorded(effects):
    scene = copy_shipped(DocumentKind.SCENE, "base")
    scene["effects"] = [*scene["effects"], *(dict(effect) for effect in effects)]
    grid = LocationGridSequence(locations_mm=PLACES_MM, strains_percent=[25.0], **_HELD)
    phases = (
        PlannedPhase("places", "location-grid", grid),
        PlannedPhase("random", "random-loads", RandomLoadsSequence(count=10, **_HELD)),
    )
    return simulated_run((), phases=phases, scene=scene, seed=1)


def not_as_modelled():
    return observed((MEMORY,))


def issued(run):
    """The calibration of a run as if it had passed."""
    recipe = replace(load_recipe("campaign").value, calibrate_phases=CALIBRATE)
    conclusion = Conclusion(run, (), Verdict(Outcome.PASS, "all limits met"), ())
    made, why = calibrate_run(conclusion, recipe, calibration="c-1", issued_at="2026-01-01T00:00:00+00:00")
    assert not why
    return made


def random_frames(run):
    """A frame of each random load, held, and where it was pressed."""
    loads, data = force_loads(run)
    chosen = [k for k, load in enumerate(loads) if load.phase == "random"]
    frames = [window_of(run, loads[k]).steady.voltages[-1] for k in chosen]
    return np.array(frames), data.place_mm[chosen]


def errors_mm(forces, places_mm):
    return np.linalg.norm(forces.place_mm - places_mm, axis=1)


def test_a_sheet_not_as_modelled_is_located_better_by_what_its_presses_taught(tmp_path):
    run = not_as_modelled()
    place = run_place(run)
    assert place.pays
    assert place.left_out.gain_mm > 2 * place.left_out.gain_stderr_mm
    assert place.words.startswith("Place learned from 39 presses: ")
    assert place.words.endswith("so a calibration uses it")
    made = issued(run)
    write_calibration(tmp_path / "sensor.h5", made)
    read = read_calibration(tmp_path / "sensor.h5")
    assert (read.place.presses, read.place.error_mm) == (39, place.left_out.learned_mm)
    frames, places_mm = random_frames(run)
    learned, modelled = Calibration(read).force(frames), Calibration(replace(read, place=None)).force(frames)
    assert errors_mm(learned, places_mm).mean() < 0.8 * errors_mm(modelled, places_mm).mean()
    # Stated errors hold, and forces gain by it too.
    assert np.mean(errors_mm(learned, places_mm) < 2.5 * learned.place_stderr_mm) > 0.7
    loads, data = force_loads(run)
    force_N = data.force_N[[load.phase == "random" for load in loads]]
    rms_N = [np.sqrt(np.mean((forces.force_N - force_N) ** 2)) for forces in (learned, modelled)]
    assert rms_N[0] < 0.8 * rms_N[1]


@pytest.mark.rest
def test_a_sheet_as_modelled_keeps_the_model_and_its_file_does_not_change():
    run = observed()
    place = run_place(run)
    assert not place.pays
    assert place.used is None
    assert place.words.endswith("not used, the model is better")
    without = replace(run, settings=replace(run.settings, learn_place=False))
    assert run_place(without).words == "Place not learned: the recipe does not ask for it"
    assert issued(run).file == issued(without).file


def test_flags_stay_and_frames_without_a_load_like_the_presses_keep_the_place_of_the_model():
    run = not_as_modelled()
    made = issued(run)
    with_place, without = Calibration(made), Calibration(replace(made, place=None))
    frames, _ = random_frames(run)
    unlike = np.stack([run.reference, np.full_like(run.reference, np.nan)])
    one, other = (each.force(np.concatenate([unlike, frames])) for each in (with_place, without))
    np.testing.assert_array_equal(one.flags, other.flags)
    assert one.flags[0] & Flag.NOT_DETECTED
    assert one.flags[1] & Flag.UNREADABLE
    np.testing.assert_array_equal(one.place_mm[:2], other.place_mm[:2])
    assert (one.place_mm[2:] != other.place_mm[2:]).any(axis=1).mean() > 0.5
    # What was learned is of the head that pressed.
    one, other = (each.force(frames, indenter=Indenter(20.0)) for each in (with_place, without))
    np.testing.assert_array_equal(one.place_mm, other.place_mm)


@pytest.mark.rest
def test_few_places_teach_nothing_and_the_run_says_why():
    place = run_place(observed(places=5))
    assert place.learned is None
    assert not place.pays
    assert place.words == "Place not learned: the loads that calibrate are at 5 places; 6 are needed"
    assert issued(observed(places=5)).place is None


def test_a_learned_place_of_other_readings_is_refused(tmp_path):
    made = issued(not_as_modelled())
    learned = made.place.learned
    scaling = replace(learned.scaling, ceiling=learned.scaling.ceiling[:-1])
    other = replace(made, place=replace(made.place, learned=replace(learned, scaling=scaling)), digest="", file=b"")
    write_calibration(tmp_path / "other.h5", replace(other, record_digest=""))
    with pytest.raises(CalibrationError, match="place/scaling/ceiling is of 103 readings, force/merging of 104"):
        read_calibration(tmp_path / "other.h5")


def test_learning_places_needs_phases_to_learn_from():
    recipe = copy_shipped(DocumentKind.RECIPE, "nine-locations")
    recipe["recipe"]["calibrate_phases"] = []
    recipe["analysis"]["learn_place"] = True
    with pytest.raises(ConfigError, match=r"learn_place.*calibrate_phases names no phase"):
        load_recipe(recipe)
