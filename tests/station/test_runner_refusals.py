"""The runner and the bench: what is refused before anything moves; every clock runs the same code."""

import re
from functools import partial
from pathlib import Path

import pytest
from runner_samples import TOOK_S, cycle, kinds, load, run

from cbsr_qa.domain.errors import ConfigError, InstrumentError, RefusedError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.plan.steps import Hold, Press, Prompt, Release
from cbsr_qa.domain.run.events import LoadFinished, PhaseFinished, RunEnded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.bench import Bench, Mounted, open_bench
from cbsr_qa.station.execution import execute
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa.testing.bench import Script, example_identity, example_plan, make_scripted_bench, raising

# --- refusals --------------------------------------------------------------------------------------------


def test_prompts_are_asked_or_refused():
    asked = []
    ended, _, _ = run((Prompt("turn the sheet"), *cycle(0)), ask=asked.append)
    assert ended.end is EndReason.FINISHED
    assert asked == ["turn the sheet"]
    with pytest.raises(RefusedError, match="no operator is present"):
        run((Prompt("turn the sheet"), *cycle(0)))


def _without_time(script, acquire, count):
    now = script.clock.now()
    frames = acquire(count)
    script.clock._now = now
    return frames


@pytest.mark.parametrize(
    ("takes", "said"),
    [
        (_without_time, "took zero time"),
        (lambda script, acquire, count: acquire(2), "frames of shape (2, 16, 16); requested (1, 16, 16)"),
    ],
)
def test_a_frame_source_that_does_something_else_breaks_the_run(takes, said):
    script, plan = Script(VirtualClock(), TOOK_S), example_plan(cycle(0))
    bench = make_scripted_bench(script, plan.sensor_type)
    bench.frame_source.acquire = partial(takes, script, bench.frame_source.acquire)
    ended = execute(plan, example_identity(), bench, script.clock, [lambda event: None])
    assert ended.end is EndReason.BROKEN
    assert said in ended.detail


def test_real_and_virtual_clock_run_the_same_code():
    # Short enough to wait for: 0.12 s of holds on the computer's clock.
    steps = (Press(load()), Hold(0.06, acquire=True), Release(), Hold(0.06, acquire=True))
    plan = example_plan(steps)
    told = {}
    for clock in (VirtualClock(), RealClock()):
        script = Script(clock)
        documents = told[type(clock)] = []
        bench = make_scripted_bench(script, plan.sensor_type, frame_period_s=0.02)
        assert execute(plan, example_identity(), bench, clock, [documents.append]).end is EndReason.FINISHED
    virtual, real = ([type(d) for d in kinds(told[c], LoadFinished, PhaseFinished, RunEnded)] for c in told)
    assert virtual == real
    record = kinds(told[RealClock], LoadFinished)[0].record
    assert record.release_start_s - record.hold_start_s >= 0.06


def test_the_example_in_the_manual_runs():
    manual = Path(__file__).parents[2] / "docs" / "explanation" / "runs.md"
    (example,) = re.findall(r"```python\n(.*?)```", manual.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(example, str(manual), "exec"), {"print": lambda event: None})


# --- the bench -------------------------------------------------------------------------------------------


def spec(role, *provides):
    return InstrumentSpec(role, "some-driver", provides, {}, "2027-01-31")


def parts():
    script = Script(VirtualClock())
    mounted = {
        one.spec.role: one.instrument for one in make_scripted_bench(script, example_plan([]).sensor_type).mounted
    }
    return script, mounted


def test_an_instrument_that_does_not_do_what_the_station_says_is_named():
    _, by_role = parts()
    with pytest.raises(ConfigError) as refused:
        Bench([Mounted(spec("scale", "frame_source"), by_role["load_cell"])])
    assert "scale (some-driver)" in refused.value.reason
    assert "acquire, frame_period_s" in refused.value.reason


def test_roles_filled_twice_or_not_at_all_are_refused():
    _, by_role = parts()
    frames = Mounted(spec("a", "frame_source"), by_role["frame_source"])
    head = Mounted(spec("b", "force_applicator"), by_role["force_applicator"])
    cell = Mounted(spec("c", "force"), by_role["load_cell"])
    with pytest.raises(ConfigError, match=r"both a .* and d"):
        Bench([frames, head, cell, Mounted(spec("d", "frame_source"), by_role["frame_source"])])
    with pytest.raises(ConfigError, match="provides 'force_applicator'"):
        Bench([frames, cell])
    with pytest.raises(ConfigError, match="samples 'force'"):
        Bench([frames, head])
    assert Bench([frames, head, cell]).identities()[0].calibration_due == "2027-01-31"


def test_a_bench_that_cannot_be_opened_closes_what_it_opened():
    script, by_role = parts()

    def make(one):
        if one.role == "load_cell":
            raise InstrumentError("load_cell", "usb", "not attached")
        return by_role[one.role]

    script.on("force_applicator.close", raising(OSError("gone")))
    with pytest.raises(InstrumentError, match="not attached"):
        open_bench([spec(role, role) for role in ("force_applicator", "frame_source", "load_cell")], make)
    assert script.names() == [
        "force_applicator.safe_state",
        "frame_source.safe_state",
        "force_applicator.close",
        "frame_source.close",
    ]
