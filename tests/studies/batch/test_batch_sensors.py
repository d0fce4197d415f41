"""What a run says about its sensor for the batch: the loads that its own map was learned from."""

from dataclasses import replace

import numpy as np
import pytest
from batches import place_sunflower
from kept_batches import keep_sample
from simulated_runs import observed_run, simulated_run

from cbsr_qa.analysis.run.force import learn_without_tests
from cbsr_qa.calibration.sheet.response_map import learn_response
from cbsr_qa.studies.batch.sensors import map_loads


@pytest.mark.rest
def test_the_map_of_the_loads_is_the_run_s_own():
    record = simulated_run(place_sunflower(6, 30.0).tolist(), hold_s=20.0, rest_s=20.0)
    run = observed_run(record, over_time=False, calibrate_phases=("grid",))
    force = learn_without_tests(run)
    loads = map_loads(run, force)
    there = place_sunflower(9, 30.0)
    found = learn_response(
        loads.places_mm,
        loads.log_response,
        loads.variance,
        radius_mm=record.sensor_type.radius_mm,
        bend=loads.bend,
        bend_stderr=loads.bend_stderr,
    )
    for ours, own in zip(found.predict(there), force.learned.response.predict(there), strict=True):
        assert ours == pytest.approx(own, rel=1e-9, abs=1e-12)
    assert np.isfinite(loads.log_response).all()
    # A prior that the run had for its map has no part in them.
    on_batch = replace(run, settings=replace(run.settings, prior="batch", batch=keep_sample()))
    with_prior = learn_without_tests(on_batch)
    assert with_prior.learned.model.batch is not None
    again = map_loads(on_batch, with_prior)
    np.testing.assert_array_equal(again.log_response, loads.log_response)
    np.testing.assert_array_equal(again.variance, loads.variance)
