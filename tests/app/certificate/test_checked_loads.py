"""Loads that a calibration was not learned from, as a certificate checks them."""

from dataclasses import replace

import numpy as np
import pytest

import cbsr_qa as qa
from cbsr_qa.analysis.run.loads import load_window, mean_force
from cbsr_qa.app.certificate.checked_loads import check_loads
from cbsr_qa.app.run.decided_again import judging_recipe
from cbsr_qa.calibration.file.hdf5 import calibration_of
from cbsr_qa.store.opening import open_store


def read_run(place):
    """Return the sensor's run, its recipe and the calibration that it issued."""
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        record, stored = store.runs.load(run), store.analyses.load(run)[0]
        file, digest = store.calibrations.load_file(stored.calibration)
        return record, judging_recipe(store, run, stored), calibration_of(file, issued=digest)


@pytest.mark.rest
def test_held_out_loads_are_checked_or_named_whatever_the_range(place):
    """A range that fewer loads agree with moves loads from one list to the other, with the same errors."""
    record, recipe, issued = read_run(place)
    wide, narrow = (
        replace(issued, validity=replace(issued.validity, force_N=(0.0, high_N))) for high_N in (100.0, 2.0)
    )
    everything, nothing = check_loads(record, recipe, qa.Calibration(wide), None)
    some, others = check_loads(record, recipe, qa.Calibration(narrow), None)
    assert (len(everything), nothing) == (5, ())
    assert 0 < len(others) < 5
    errors_N = {load.reference_N: load.error_N for load in (*some, *others)}
    assert errors_N == {load.reference_N: load.error_N for load in everything}
    assert all(not load.why and load.reference_N > 2.0 for load in others)


@pytest.mark.rest
def test_a_load_that_ends_the_range_is_checked(place):
    """The range ends at means over the steady frames; the last of them, whose error is stated, has another force."""
    record, recipe, issued = read_run(place)
    (phase,) = [phase for phase in record.phases if phase.name == "random loads"]
    for load in phase.loads:
        steady_N, _ = mean_force(phase.channel("force"), load_window(phase, load, recipe.analysis).steady, load)
        radius_mm = float(np.hypot(load.load.x_mm, load.load.y_mm))
        for range_N in ((0.0, steady_N), (steady_N, 100.0)):
            ends_here = replace(issued.validity, force_N=range_N, radius_mm=radius_mm)
            checked, _ = check_loads(record, recipe, qa.Calibration(replace(issued, validity=ends_here)), None)
            assert (load.load.x_mm, load.load.y_mm) in [one.expanded.place_mm for one in checked]
