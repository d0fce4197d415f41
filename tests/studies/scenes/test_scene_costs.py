"""What effects are said to cost is what they cost."""

import sys
import time

import pytest
from scene_samples import HEAD, PIEZORESISTIVE, load_table, written
from simulated_setting import installed, scene, world

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.studies.scenes.costs import Watched, _clear, measure_costs, plan_recording
from cbsr_qa.studies.scenes.setting import set_up

pytestmark = pytest.mark.rest

SLOW_S = 0.005
SAMPLES_A_FRAME = 20  # 8 a second for 2.5 s


def _effect(perturbs, act, *, needs=(), method="apply"):
    """An effect that does something with the computer's time."""
    members = {"__init__": lambda self, setting: None, "needs": tuple(needs), "perturbs": perturbs}
    return type("Timed", (), members | {method: lambda self, changed: act()})


def _work():
    begun_s = time.process_time()  # sleeping costs nothing
    while time.process_time() < begun_s + SLOW_S:
        pass


def _slow(perturbs, **more):
    """An effect that takes its time."""
    return _effect(perturbs, _work, **more)


def _effects(*names):
    return "".join(f'[[effects]]\nname = "{name}"\n' for name in names)


def _costs(tmp_path, text, **made):
    setup = set_up(str(written(tmp_path, text)), recorded=False)
    return setup, measure_costs(setup, lambda name: made[name] if name in made else installed(name))


def test_the_time_within_an_effect_is_its_cost(tmp_path):
    text = HEAD + load_table() + PIEZORESISTIVE + _effects("slow", "johnson-noise")
    _, costs = _costs(tmp_path, text, slow=_slow("voltages"))
    assert costs.effect_ms["slow"] >= 1e3 * SLOW_S
    assert 0 < costs.effect_ms["johnson-noise"] < costs.effect_ms["slow"]
    assert costs.frame_ms > costs.effect_ms["slow"]
    assert costs.compute_s > 40 * SLOW_S  # of 40 frames


def test_an_effect_on_the_force_costs_all_samples_of_a_frame(tmp_path):
    _, costs = _costs(tmp_path, HEAD + load_table() + _effects("slow"), slow=_slow("force"))
    assert costs.effect_ms["slow"] >= 1e3 * SAMPLES_A_FRAME * SLOW_S


def test_what_happens_once_a_scene_is_shared_out_over_its_frames_and_kept_apart(tmp_path):
    made = {
        "plan": _slow("sheet", method="design"),
        "write": _slow("recording", method="record"),
        "each": _slow("voltages"),
    }
    _, costs = _costs(tmp_path, HEAD + _effects(*made), **made)
    for name in ("plan", "write"):
        assert costs.once_ms[name] >= 1e3 * SLOW_S
        assert costs.effect_ms[name] >= max(costs.each_ms[name], 1e3 * SLOW_S / 40)
    assert costs.effect_ms["write"] < 1e3 * SLOW_S / 2
    assert costs.each_ms["each"] >= 1e3 * SLOW_S
    assert costs.once_ms["each"] == 0


def test_differences_that_are_noise_are_no_cost():
    """What is done more makes no frame shorter: differences below zero tell how large noise is."""
    assert _clear([0.1, 0.2, 0.9, 0.4, 0.8]) == 0.4
    assert _clear([-0.001, 0.15, 0.94, 0.17, 1.08]) == 0.17  # frames differ, and each is longer
    assert _clear([0.47, -0.42, 0.24, 0.45, 0.45]) == 0
    assert _clear([-0.1, -0.2, -0.3]) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="time of the processor is counted in steps of 15.6 ms")
def test_what_else_the_computer_does_is_no_effects_cost(tmp_path):
    """Time in which the process has no processor, as here while it sleeps, is not counted."""
    waiting = _effect("voltages", lambda: time.sleep(0.02))
    _, costs = _costs(tmp_path, HEAD + _effects("waiting"), waiting=waiting)
    assert costs.effect_ms["waiting"] < 10


def test_an_effect_that_is_needed_costs_what_needs_it_too(tmp_path):
    """Without it they cannot be there: the difference of a frame counts them."""
    made = {"later": _slow("voltages", needs=["piezoresistivity"])}
    _, costs = _costs(tmp_path, HEAD + load_table() + PIEZORESISTIVE + _effects("later"), **made)
    assert costs.effect_ms["piezoresistivity"] >= costs.effect_ms["later"] * 0.9


def test_readings_one_after_the_other_cost_the_further_solutions_they_ask_for(tmp_path):
    """The response is asked for at both ends of a frame and in its middle, instead of once."""
    text = HEAD + load_table() + _effects("slow", "time-skew")
    setup, costs = _costs(tmp_path, text, slow=_slow("response"))
    assert costs.effect_ms["time-skew"] >= 1.5e3 * SLOW_S
    assert set(costs.effect_ms) == {choice.name for choice in setup.plan.scene.effects}


def test_a_scene_for_a_station_is_measured_with_one_load(tmp_path):
    setup = set_up(str(written(tmp_path, HEAD.split("[sensor]")[0])), recorded=False)
    plan = plan_recording(setup)
    assert [load.place_mm for load in plan.loads] == [(0.0, 0.0)]
    assert plan.frame_count > 20
    recorded = set_up(str(written(tmp_path, HEAD)), recorded=False)
    assert plan_recording(recorded) is recorded.plan


def test_a_frame_that_cannot_be_taken_is_refused_with_the_scenes_file(tmp_path):
    drift = '[[effects]]\nname = "temperature-drift"\ncoefficient_per_K = -0.05\nswing_K = 10.0\nperiod_s = 1e3\n'
    warm = drift + "rate_K_per_h = 20.0\n"
    long = HEAD.replace("100.0", "20000.0")
    with pytest.raises(ConfigError, match=r"mine\.toml: temperature-drift leaves no conductance"):
        _costs(tmp_path, long + warm)


def test_watched_effects_do_what_they_do():
    watched = Watched(installed)
    names = ("piezoresistivity", "measurement-noise")
    seen, plain = world(scene(*names), effect_factory=watched), world(scene(*names))
    assert set(watched.effects) == set(names)
    within = watched.time_call(lambda: seen.voltages_V(3.0, 1))
    assert within["measurement-noise"] > 0
    assert (seen.voltages_V(3.0, 1) == plain.voltages_V(3.0, 1)).all()
