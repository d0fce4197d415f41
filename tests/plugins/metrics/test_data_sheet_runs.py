"""Data-sheet figures of simulated runs against what the simulated world knows to be true."""

import re
import tomllib
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from effect_setting import history, setting
from simulated_runs import HEAD, observed_run, simulated_run

from cbsr_qa.calibration.fits.creep_fit import trace_of
from cbsr_qa.calibration.sheet.data_sheet import place_responses
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.simulate.ramps import Transients
from cbsr_qa_plugins.effects.sheet import UnevenResponse
from cbsr_qa_plugins.metrics.data_sheet import Creep, Nonlinearity, Repeatability, ZeroReturn
from cbsr_qa_plugins.metrics.mechanics import ApparentModulus, Uniformity

_TABLES = ("scene", "effects")
_QUIET = 1e-6  # relative noise: what is left of a figure's error is the figure's own
_PLACES = ((0.0, 0.0), (30.0, 0.0), (-15.0, 15.0), (0.0, -30.0))
_STRAINS = (0.1, 0.2, 0.3)


def _scene(*added):
    text = files("cbsr_qa._stations").joinpath("scenes", "base.toml").read_text()
    data = {key: value for key, value in tomllib.loads(text).items() if key in _TABLES}
    return {**data, "effects": [*data["effects"], *added]}


def _observed(record, role=Role.GRID):
    return observed_run(replace(record, phases=tuple(replace(phase, role=role) for phase in record.phases)))


def _loads(strains, trials=1):
    return tuple(
        Load(f"L{i}", *place, strain, trial)
        for strain in strains
        for trial in range(trials)
        for i, place in enumerate(_PLACES)
    )


@pytest.fixture(scope="module")
def quiet():
    return _observed(simulated_run((), loads=_loads(_STRAINS), noise=_QUIET))


def _one(metric, run, name=None, qualifier=""):
    found = metric.measure_run(run)
    return next(m for m in found if m.qualifier == qualifier and not m.location and (name in (None, m.name)))


def _press(run, load):
    """The press as the world saw it, in units of its strain."""
    record = load.record
    ramp_s = record.load.strain * run.record.sensor_type.thickness_mm / (40 / 60)
    return history((record.hold_start_s - ramp_s, ramp_s, 1.0), (record.release_start_s, ramp_s, -1.0))


def _conductance(run, load, time_s):
    """Change of the sheet over its quasi-static one at a time of the run, from the material's kernels alone."""
    material, press = run.record.material, _press(run, load)
    transients = Transients(material.loading_relaxation, material.unloading_relaxation)
    return press.strain_at(time_s) + transients.change_at(press, time_s)


def _frames(load, *, loading):
    """Times on the run's clock of the frames a trace is made of."""
    start_s = load.record.hold_start_s if loading else load.record.unloaded_s
    return start_s + trace_of(load, "conductance", loading=loading).time_s


def test_the_modulus_is_the_materials(quiet):
    true_kPa = quiet.record.material.modulus_kPa.value
    ratio, slope = (_one(ApparentModulus(), quiet, qualifier=q) for q in ("", "slope"))
    assert ratio.value == pytest.approx(true_kPa, rel=0.02)
    assert slope.value == pytest.approx(true_kPa, rel=0.005)  # the contact height is no part of it
    assert (ratio.unit, ratio.uncertainty > 0) == ("kPa", True)
    each = {m.location: m.value for m in ApparentModulus().measure_run(quiet) if m.location and not m.qualifier}
    assert list(each) == ["L0", "L1", "L2", "L3"]
    assert list(each.values()) == pytest.approx([true_kPa] * 4, rel=0.04)


def test_creep_is_what_the_materials_kernels_say(quiet):
    load = quiet.loads[-1]
    times_s = _frames(load, loading=True)
    end = np.mean([_conductance(quiet, load, t) for t in times_s[-4:]])
    early = _conductance(quiet, load, load.record.hold_start_s + 5.0)
    of_conductance = 100 * (end - early) / end
    found = _one(Creep(), quiet, qualifier="conductance")
    assert found.value == pytest.approx(of_conductance, abs=1.0)

    kernel, press = quiet.record.material.stress_relaxation, _press(quiet, load)
    transients = Transients(kernel, kernel)
    from_s, until_s = times_s[-4], load.record.release_start_s
    last = 1 + np.mean([transients.change_at(press, t) for t in np.linspace(from_s, until_s, 50)])
    of_stress = 100 * (last - 1 - transients.change_at(press, load.record.hold_start_s + 5.0)) / last
    assert _one(Creep(), quiet, qualifier="stress").value == pytest.approx(of_stress, abs=0.3)
    assert _one(Creep(), quiet).value == pytest.approx(of_conductance - of_stress, abs=1.0)


def test_zero_return_is_what_the_kernels_leave(quiet):
    load = quiet.loads[-1]
    left, held = (
        np.mean([_conductance(quiet, load, t) for t in _frames(load, loading=loading)[-4:]])
        for loading in (False, True)
    )
    assert _one(ZeroReturn(), quiet).value == pytest.approx(100 * left / held, abs=1.0)


@pytest.mark.rest
def test_a_residue_appears_as_zero_return_with_its_share(quiet):
    scene = _scene({"name": "residue", "share": 0.08, "decay_s": 900.0})
    run = _observed(simulated_run((), loads=_loads(_STRAINS[-1:]), noise=_QUIET, scene=scene))
    load = run.loads[-1]
    released_s = load.record.release_end_s
    held = np.mean([_conductance(run, load, t) for t in _frames(load, loading=True)[-4:]])
    fade = np.mean([np.exp(-(t - released_s) / 900.0) for t in _frames(load, loading=False)[-4:]])
    more = _one(ZeroReturn(), run).value - _one(ZeroReturn(), quiet).value
    assert more == pytest.approx(100 * 0.08 * fade / held, abs=0.8)


def test_an_even_sheet_is_even_and_linear(quiet):
    own, imaged = (_one(Uniformity(), quiet, qualifier=q) for q in ("", "baseline conductance"))
    assert own.value < 0.5
    assert imaged.value > 20  # what imaging makes of the centre and of 30 mm out
    assert _one(Nonlinearity(), quiet).value < 1.5
    refused = _one(Repeatability(), quiet)
    assert refused.value is None


@pytest.mark.rest
def test_an_uneven_response_is_found_where_it_is():
    places = [(20.0 * np.cos(a), 20.0 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 6, endpoint=False)]
    places = [(0.0, 0.0), *((round(x, 2), round(y, 2)) for x, y in places)]
    uneven = {"name": "uneven-response", "deviation": 0.25, "correlation_mm": 20.0}
    run = _observed(simulated_run(places, seed=5, noise=_QUIET, scene=_scene(uneven)))
    at = setting(seed=5)
    design = SheetDesign.make_uniform(at.sensor_type, at.indenter)
    UnevenResponse(at, deviation=0.25, correlation_mm=20.0).design(design)
    rings = HEAD.radius_mm * np.sqrt((np.arange(12) + 0.5) / 12)
    head = np.concatenate(
        [r * np.column_stack([np.cos(t), np.sin(t)]) for r in rings for t in [np.arange(24) / 3.82]]
    )
    true = np.array([design.response_at(head + place).mean() for place in places])
    found, strain = place_responses(run, run.loads)
    assert strain == 0.2
    response = np.array([place.response for place in found])
    assert response / response.mean() == pytest.approx(true / true.mean(), abs=0.05)
    spread = 100 * true.std(ddof=1) / true.mean()
    assert spread > 8  # the seed makes a sheet that is worth measuring
    assert _one(Uniformity(), run).value == pytest.approx(spread, rel=0.15)


@pytest.mark.rest
def test_repeatability_is_the_noise_of_the_sensed_change():
    """Three presses of each place under the material's own noise: the scatter is that of the unloaded images."""
    run = _observed(simulated_run((), loads=_loads((0.2,), trials=3)))
    found = _one(Repeatability(), run)
    relative = []
    for place in range(len(_PLACES)):
        members = [load for load in run.loads if load.record.load.label == f"L{place}"]
        for load in members:
            blob = load.mask(0.85).sensed
            areas = blob.image.mesh.areas_mm2[blob.elements]
            weights = areas / areas.sum()
            noise = (run.noise_images[:, blob.elements] @ weights).std(ddof=1) / np.sqrt(load.steady_frames)
            relative.append(noise / (load.image.values[blob.elements] @ weights))
    expected = 100 * np.sqrt(np.mean(np.square(relative)))
    assert found.value == pytest.approx(expected, rel=0.6)  # 8 degrees of freedom here, 7 there
    # Of an even sheet nothing is left but that scatter: places are means of three presses.
    even = _one(Uniformity(), run)
    said = float(re.search(r"alone would make ([\d.]+) %", even.how)[1])
    assert said == pytest.approx(found.value / np.sqrt(3), rel=0.1)
    assert even.value < 3 * said


def test_a_load_that_was_sensed_elsewhere_says_nothing_about_its_place(quiet):
    """The blobs of L1 and L3 at 30 % strain are exchanged: the model of a head at L1 has nothing at L3."""
    strong = [load for load in quiet.loads if load.record.load.strain == 0.3]
    one, other = (next(load for load in strong if load.record.load.label == label) for label in ("L1", "L3"))
    swapped = (replace(one, masks=other.masks), replace(other, masks=one.masks))
    rest = tuple(load for load in strong if load is not one and load is not other)
    found, _ = place_responses(quiet, (*rest, *swapped))
    assert [place.location for place in found] == ["L0", "L2"]
    refused = _one(Uniformity(), replace(quiet, loads=(*rest, *swapped)))
    assert refused.value is None


@pytest.mark.rest
def test_a_sheet_that_conducts_less_under_load_has_the_same_data_sheet():
    """At 3 % strain: readings are not quite odd in the conductance, and small strain makes them so."""

    def run(gauge):
        record = simulated_run((), loads=_loads((0.03,)), noise=1e-8, gauge=gauge)
        stress = record.material.against_stress
        signed = replace(stress, slope=replace(stress.slope, value=gauge * stress.slope.value))
        return _observed(replace(record, material=replace(record.material, against_stress=signed)))

    rising, falling = run(1.0), run(-1.0)
    assert (rising.response, falling.response) == ("increase", "decrease")
    for metric in (Creep(), ZeroReturn(), Uniformity(), ApparentModulus()):
        for qualifier in ("conductance", "") if isinstance(metric, Creep) else ("",):
            up, down = (_one(metric, one, qualifier=qualifier).value for one in (rising, falling))
            assert down == pytest.approx(up, rel=0.03, abs=0.3)
