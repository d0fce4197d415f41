"""A run whose loads are held at the same time: each is measured on its own region, what shares one is said."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import observed_run

from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Indenter, Load, LoadRecord
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.run import PhaseRecord, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.testing.bench import example_identity
from cbsr_qa_plugins.metrics.images import GreitFiguresOfMerit, LoadAssignment, TwoTouchResolution
from cbsr_qa_plugins.metrics.location import AreaOverlap, CentreOfMassError

SENSOR = load_sensor_type("disc-100mm").value
HEAD = Indenter(13.0)
_PERIOD_S = 2.5


@pytest.fixture(scope="module")
def sheet() -> SimulatedSheet:
    return SimulatedSheet(SheetDesign.make_uniform(SENSOR, HEAD), size_mm=4.0, interelectrode_resistance_ohm=1e4)


@pytest.fixture(scope="module")
def observed(sheet):
    """Twenty unloaded frames, then several places held together for twenty."""

    def observe(*places: tuple[float, float], **settings: object) -> RunObservation:
        random = np.random.default_rng(8)
        clean = [sheet.unloaded] * 20 + [sheet.voltages(dict.fromkeys(places, 0.12))] * 20
        voltages = np.array(clean) * (1 + 1e-4 * random.standard_normal((40, *sheet.unloaded.shape)))
        time_s = _PERIOD_S * np.arange(40.0)
        frames = FrameBlock(time_s, voltages, np.zeros(voltages.shape, np.uint8), VoltageUnit.VOLT, 1e-3)
        start_s, end_s = float(time_s[20]) - 1, float(time_s[-1]) + 1
        loads = tuple(
            LoadRecord(k, Load(f"L{k}", x, y, 0.2, 0), start_s - 1, start_s, end_s, end_s + 1, end_s + 1)
            for k, (x, y) in enumerate(places)
        )
        phase = PhaseRecord(0, "together", "any", 0.0, end_s + 2, frames, (), loads, 0.0, Role.GRID)
        material = load_material("cbsr-8wt").value
        record = RunRecord(example_identity(), SENSOR, material, HEAD, (phase,), EndReason.FINISHED)
        return observed_run(record, **settings)

    return observe


def _values(metric, run: RunObservation, name: str) -> list[float | None]:
    """The main mask's values, load by load."""
    taken = [m for load in run.loads for m in metric.measure_load(load, run)]
    return [m.value for m in taken if m.name == name and not m.qualifier]


@pytest.mark.parametrize("outline", ["contour", "elements"])
def test_each_of_two_loads_apart_has_a_region_of_its_own(observed, outline):
    run = observed((25.0, 0.0), (-25.0, 0.0), outline=outline)
    assert [load.together for load in run.loads] == [2, 2]
    assert [load.mask(0.85).fate for load in run.loads] == ["apart", "apart"]
    for load in run.loads:
        x_mm, _ = load.mask(0.85).region.centre_mm()
        assert np.sign(x_mm) == np.sign(load.record.load.x_mm)
    assert max(_values(CentreOfMassError(), run, "centre_of_mass_error")) < 3.0
    assert min(_values(AreaOverlap(), run, "area_overlap")) > 50.0
    assert _values(LoadAssignment(), run, "false_regions") == [0.0, 0.0]
    assert [m.value for m in LoadAssignment().measure_run(run)] == [0.0, 0.0]
    assert np.isfinite(run.timelines[0].error_mm[-1, 20:]).all()


def test_two_loads_close_together_are_merged_and_said_so(observed):
    run = observed((7.0, 0.0), (-7.0, 0.0))
    assert [load.mask(0.85).fate for load in run.loads] == ["merged", "merged"]
    errors = [m for load in run.loads for m in CentreOfMassError().measure_load(load, run) if not m.qualifier]
    (alone,) = [m for m in errors if m.value is None]
    assert "shares the region of another load" in alone.how
    missed, merged = LoadAssignment().measure_run(run)
    assert (missed.name, missed.value, merged.name, merged.value) == ("missed_loads", 0.0, "merged_loads", 2.0)


def test_a_load_that_left_nothing_is_missed_not_given_the_others_region(observed):
    run = observed((30.0, 0.0), (-30.0, 0.0), main_mask=0.85)
    # The same run, said to have pressed a third place.
    record = run.record.phases[0]
    elsewhere = replace(record.loads[0], index=2, load=Load("L2", 0.0, 35.0, 0.2, 0))
    claimed = replace(run.record, phases=(replace(record, loads=(*record.loads, elsewhere)),))
    seen = observed_run(claimed)
    assert [load.mask(0.85).fate for load in seen.loads] == ["apart", "apart", "missed"]
    (error,) = [m for m in CentreOfMassError().measure_load(seen.loads[2], seen) if not m.qualifier]
    assert error.value is None
    assert "no region lies within a head's diameter" in error.how
    assert [m.value for m in LoadAssignment().measure_run(seen)] == [1.0, 0.0]


def test_a_load_alone_takes_the_nearest_region_and_the_rest_is_false(observed):
    run = observed((20.0, 10.0))
    assert [(load.together, load.mask(0.85).fate) for load in run.loads] == [(1, "apart")]
    (count,) = _values(LoadAssignment(), run, "false_regions")
    assert count == run.loads[0].mask(0.85).regions - 1


def test_greit_figures_of_a_simulated_load(observed):
    run = observed((20.0, 0.0))
    found = {m.name: m for m in GreitFiguresOfMerit().measure_load(run.loads[0], run)}
    # The material file expects as much at 20 % strain as the sheet was made to change.
    assert run.record.material.against_strain.slope.value * 0.2 == pytest.approx(0.12, abs=0.01)
    assert found["amplitude_response"].value == pytest.approx(1.0, abs=0.5)
    assert abs(found["position_error"].value) < 3.0
    assert found["position_error"].unit == "mm"
    # No image is finer than the head: a quarter amplitude set of at least its area.
    assert 6.5 / 50 < found["resolution"].value < 0.5
    assert 0 <= found["shape_deformation"].value < 0.5
    assert 0 <= found["ringing"].value < 2.0


def test_an_image_of_the_other_sign_has_no_greit_figures(observed):
    run = observed((20.0, 0.0))
    load = run.loads[0]
    dark = replace(load, image=replace(load.image, values=-np.abs(load.image.values)))
    found = GreitFiguresOfMerit().measure_load(dark, run)
    assert {m.value for m in found} == {None}
    assert all(m.how.startswith("not detected") for m in found)


def test_two_touch_resolution_of_the_runs_reconstruction(observed):
    run = observed((0.0, 0.0))
    contour, watershed = TwoTouchResolution().measure_run(run)
    assert (contour.name, contour.unit, watershed.qualifier) == ("two_touch_resolution", "mm", "watershed")
    assert 13.0 < watershed.value < contour.value < 40.0


def test_a_region_of_contours_has_no_nodes_to_count(observed):
    with pytest.raises(NumericsError, match="elements"):
        observed((20.0, 0.0), perimeter="nodes")
