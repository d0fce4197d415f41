"""The runner: documents in order, the journal first, retries, records of loads, and room to resume."""

import re
from pathlib import Path

import pytest

from cbsr_qa.clock import RealClock, VirtualClock
from cbsr_qa.domain.errors import ConfigError, InstrumentError, PluginError, RefusedError, StoreError
from cbsr_qa.domain.loads import Load
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.plan import InstrumentSpec
from cbsr_qa.domain.run_events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunStarted,
    SamplesTaken,
    StepRetried,
    StepStarted,
    Unloaded,
)
from cbsr_qa.domain.steps import (
    AcquireFrames,
    Ease,
    FindSurface,
    Hold,
    Home,
    MarkUnloaded,
    Press,
    Prompt,
    Release,
    Role,
)
from cbsr_qa.runner.bench import Bench, Mounted, open_bench
from cbsr_qa.runner.execute import execute
from cbsr_qa.runner.plan import PlannedPhase
from cbsr_qa.runner.schedule import schedule
from cbsr_qa.testing.bench import (
    FixedSequence,
    Script,
    ScriptedInstrument,
    example_identity,
    example_plan,
    raising,
    scripted_bench,
)

TOOK_S = {
    "force_applicator.home": 6.0,
    "force_applicator.find_surface": 9.0,
    "force_applicator.move_to": 3.0,
    "force_applicator.press": 3.5,
    "force_applicator.release": 3.25,
}
SET_UP = (FindSurface(0, 0), Hold(240, acquire=False), MarkUnloaded(), AcquireFrames(16))


def load(number=0, strain=0.2, x_mm=0.0):
    return Load(f"L{number}", x_mm, 0.0, strain, 0)


def cycle(number=0, **options):
    return (Press(load(number, **options)), Hold(60, acquire=True), Release(), Hold(60, acquire=True))


def run(*phases, script=None, done=frozenset(), listeners=(), journal=None, **options):
    """Execute phases on a scripted bench; return how it ended, the documents, the script."""
    script = script or Script(VirtualClock(), TOOK_S)
    plan = example_plan(*phases)
    documents = []
    bench = scripted_bench(script, plan.sensor_type)
    subscribers = [journal or documents.append, *listeners]
    ended = execute(plan, example_identity(), bench, script.clock, subscribers, done=done, **options)
    return ended, documents, script


def kinds(documents, *which):
    return [document for document in documents if isinstance(document, which)]


def test_documents_come_in_order():
    ended, documents, _ = run((*SET_UP, *cycle(0), *cycle(1, x_mm=30.0)), cycle(2))
    told = kinds(documents, RunStarted, PhaseStarted, Unloaded, LoadFinished, PhaseFinished, RunEnded)
    assert [type(document) for document in told] == [
        RunStarted,
        PhaseStarted,
        Unloaded,
        LoadFinished,
        LoadFinished,
        PhaseFinished,
        PhaseStarted,
        LoadFinished,
        PhaseFinished,
        RunEnded,
    ]
    assert documents[-1] is ended
    assert (ended.end, ended.detail) == (EndReason.FINISHED, "")
    assert [(d.phase, d.record.index, d.record.load.label) for d in kinds(documents, LoadFinished)] == [
        (0, 0, "L0"),
        (0, 1, "L1"),
        (1, 0, "L2"),
    ]


def test_a_run_begins_with_homing_once():
    _, documents, script = run(cycle(0), cycle(1))
    assert kinds(documents, StepStarted)[0].step == Home()
    assert script.count("force_applicator.home") == 1
    assert script.names().index("force_applicator.home") < script.names().index("force_applicator.move_to")
    assert run((Home(), *cycle(0)))[2].count("force_applicator.home") == 1


def test_times_of_a_load():
    _, documents, script = run(cycle(0), cycle(1))
    first, second = (d.record for d in kinds(documents, LoadFinished))
    assert first.press_start_s == TOOK_S["force_applicator.home"] + TOOK_S["force_applicator.move_to"]
    assert first.hold_start_s - first.press_start_s == TOOK_S["force_applicator.press"]
    assert first.release_start_s - first.hold_start_s == 60
    assert first.release_end_s - first.release_start_s == TOOK_S["force_applicator.release"]
    assert first.rest_end_s - first.release_end_s == 60
    assert second.rest_end_s == script.clock.now()


def records(script, *steps):
    return [d.record for d in kinds(run(steps, script=script)[1], LoadFinished)]


def test_the_head_leaves_the_sheet_a_stroke_at_press_speed_after_it_starts_up():
    shallow, deep = records(None, *cycle(0, strain=0.1), *cycle(1, strain=0.3))
    for record, depth_mm in ((shallow, 0.4), (deep, 1.2)):
        assert record.clear_s == pytest.approx(record.release_start_s + depth_mm / (40 / 60))
        assert record.unloaded_s == record.clear_s < record.release_end_s


LOOP = (
    Press(load(0, strain=0.1)),
    Hold(20, acquire=True),
    Ease(0.3),
    Hold(30, acquire=True),
    Ease(0.2),
    Hold(20, acquire=True),
    Release(),
    Hold(60, acquire=True),
)


def test_a_press_that_is_eased_is_one_load_with_every_strain_it_was_held_at():
    script = Script(VirtualClock(), TOOK_S)
    loop, after = records(script, *LOOP, *cycle(1))
    depths_mm = [call.arguments[0] for call in script.calls if call.name == "force_applicator.press"]
    assert depths_mm == pytest.approx([0.4, 1.2, 0.8, 0.8])
    assert script.count("force_applicator.release") == 2  # it did not leave the sheet in between
    assert [(round(one.strain, 9), one.end_s - one.start_s) for one in loop.held] == [(0.1, 20), (0.3, 30), (0.2, 20)]
    assert [one.hold_start_s - one.start_s for one in loop.eased] == [TOOK_S["force_applicator.press"]] * 2
    assert loop.clear_s == pytest.approx(loop.release_start_s + 0.8 / (40 / 60))  # from the last depth
    assert after.eased == ()
    assert [(one.strain, one.start_s, one.end_s) for one in after.held] == [
        (0.2, after.hold_start_s, after.release_start_s)
    ]


def test_a_loop_that_was_done_is_left_out_whole_and_one_that_was_cut_off_begins_again():
    _, documents, script = run((*SET_UP, *LOOP, *cycle(1)), done=frozenset({(0, 0)}))
    assert [d.record.index for d in kinds(documents, LoadFinished)] == [1]
    assert not any(isinstance(d.step, Ease) for d in kinds(documents, StepStarted))
    _, documents, script = run((*SET_UP, *cycle(1), *LOOP), done=frozenset({(0, 0)}))
    assert [call.arguments[0] for call in script.calls if call.name == "force_applicator.press"] == pytest.approx(
        [0.4, 1.2, 0.8]
    )


def test_a_head_that_is_up_has_left_the_sheet():
    (record,) = records(Script(VirtualClock(), TOOK_S | {"force_applicator.release": 0.5}), *cycle(0))
    assert record.clear_s == record.release_end_s == record.release_start_s + 0.5


def test_nobody_knows_when_a_release_that_was_tried_again_left_the_sheet():
    script = Script(VirtualClock(), TOOK_S)
    script.on("force_applicator.release", raising(lost("force_applicator")))
    first, second = records(script, *cycle(0), *cycle(1))
    assert (first.clear_s, first.unloaded_s) == (None, first.release_end_s)
    assert second.clear_s is not None


def test_phases_say_what_they_are_for():
    class Silent:
        def steps(self, context):
            yield from cycle(0)

    planned = (
        PlannedPhase("a", "fixed", FixedSequence(cycle(0), Role.GRID)),
        PlannedPhase("b", "silent", Silent()),
    )
    _, documents, _ = run(*planned)
    assert [d.role for d in kinds(documents, PhaseStarted)] == [Role.GRID, Role.OTHER]


@pytest.mark.parametrize("role", ["grid", None, 3])
def test_a_role_that_is_none_is_refused_before_anything_moves(role):
    script = Script(VirtualClock(), TOOK_S)
    with pytest.raises(PluginError, match=r"sequence 'fixed' of phase 'a' has role .*, which is no Role") as refused:
        run(PlannedPhase("a", "fixed", FixedSequence(cycle(0), role)), script=script)
    assert "Role.GRID" in refused.value.remedy
    assert script.calls == []


def test_frames_fill_holds_and_rests_one_at_a_time():
    _, documents, script = run(cycle(0))
    assert len(kinds(documents, FramesTaken)) == 48
    assert all(len(d.frames) == 1 for d in kinds(documents, FramesTaken))
    assert script.count("frame_source.acquire") == 48


def test_a_hold_is_never_shorter_than_asked_and_takes_at_least_one_frame():
    for hold_s, frames, takes_s in ((1.0, 1, 2.5), (6.0, 3, 7.5), (5.1, 2, 5.1)):
        _, documents, script = run((Press(load()), Hold(hold_s, acquire=True), Release()))
        record = kinds(documents, LoadFinished)[0].record
        assert record.release_start_s - record.hold_start_s == pytest.approx(takes_s)
        assert script.count("frame_source.acquire") == frames


def test_every_force_sample_is_told_once():
    script = Script(VirtualClock(), TOOK_S)
    _, documents, script = run((*SET_UP, *cycle(0)), script=script)
    times = [round(float(t) * 10) for d in kinds(documents, SamplesTaken) for t in d.samples.time_s]
    assert times == list(range(1, int(script.clock.now() * 10) + 1))


def test_depth_is_strain_times_thickness_at_the_press_speed():
    _, _, script = run(cycle(0, strain=0.2))
    pressed = next(call for call in script.calls if call.name == "force_applicator.press")
    assert pressed.arguments == pytest.approx((0.8, 40 / 60))  # 20 % of 4 mm at 40 mm/min


def test_time_spent_adds_up_to_the_run():
    ended, _, _ = run((*SET_UP, *cycle(0), *cycle(1)))
    assert sum(seconds for _, seconds in ended.spent) == pytest.approx(ended.time_s)
    assert dict(ended.spent) == pytest.approx(
        {
            "home": 6.0,
            "surface finding": 9.0,
            "travel": 9.0,
            "press": 7.0,
            "hold": 120.0,
            "release": 6.5,
            "rest": 360.0,
            "frames": 40.0,
        }
    )


def test_remaining_time_falls_to_what_the_last_step_takes():
    _, documents, _ = run((*SET_UP, *cycle(0)), cycle(1))
    remaining = [d.remaining_s for d in kinds(documents, StepStarted)]
    assert remaining == sorted(remaining, reverse=True)
    assert remaining[-1] == pytest.approx(60)


def test_listeners_see_only_what_the_journal_has():
    journal, seen = [], []

    def listener(event):
        seen.append(event)
        assert journal[: len(seen)] == seen

    warnings = []
    run((*SET_UP, *cycle(0)), journal=journal.append, listeners=[listener], warn=warnings.append)
    assert warnings == []
    assert seen == journal


def test_a_listener_that_fails_is_warned_about_once_and_stops_nothing():
    calls, warnings, others = [], [], []

    def broken(event):
        calls.append(event)
        raise ValueError("no screen")

    ended, documents, _ = run(cycle(0), listeners=[broken, others.append], warn=warnings.append)
    assert ended.end is EndReason.FINISHED
    assert len(calls) == 1
    assert len(warnings) == 1
    assert "no screen" in warnings[0]
    assert others == documents


@pytest.mark.parametrize("kind", [RunStarted, StepStarted, FramesTaken, SamplesTaken, LoadFinished, PhaseFinished])
def test_a_journal_that_cannot_store_breaks_the_run(kind):
    told = []

    def journal(event):
        if isinstance(event, kind):
            raise OSError("disk full")
        told.append(event)

    seen = []
    ended, _, script = run((*SET_UP, *cycle(0)), journal=journal, listeners=[seen.append])
    assert ended.end is EndReason.BROKEN
    assert "'journal'" in ended.detail
    assert "disk full" in ended.detail
    assert not any(isinstance(event, kind) for event in seen)  # not stored, so nobody saw it
    assert script.count("force_applicator.safe_state") == 2
    assert told[-1] is ended


def test_a_run_whose_end_cannot_be_stored_did_not_finish():
    def journal(event):
        if isinstance(event, RunEnded):
            raise OSError("disk full")

    seen = []
    ended, _, _ = run(cycle(0), journal=journal, listeners=[seen.append])
    assert ended.end is EndReason.BROKEN
    assert "disk full" in ended.detail
    assert seen[-1] is ended


def test_a_disk_that_stays_full_is_told_once_with_what_to_do():
    def journal(event):
        if not isinstance(event, RunStarted):
            raise StoreError("database runs.db cannot grow", remedy="free space")

    ended, _, _ = run(cycle(0), journal=journal)
    assert ended.end is EndReason.BROKEN
    assert ended.detail.startswith("rule 'journal': the journal could not store PhaseStarted: database")
    assert ended.detail.endswith("; free space")
    assert ended.detail.count("cannot grow") == 1


# --- retries ---------------------------------------------------------------------------------------------


def lost(role="frame_source"):
    return InstrumentError(role, "COM3", "no reply", retryable=True)


@pytest.mark.parametrize(
    "name",
    ["frame_source.acquire", "force_applicator.release", "force_applicator.move_to", "load_cell.samples_since"],
)
def test_a_lost_reply_is_asked_for_again(name):
    script = Script(VirtualClock(), TOOK_S)
    script.on(name, raising(lost()))
    ended, documents, _ = run(cycle(0), script=script)
    assert ended.end is EndReason.FINISHED
    (retried,) = kinds(documents, StepRetried)
    assert (retried.attempt, retried.why) == (1, "frame_source at COM3: no reply")


def test_retries_come_to_an_end():
    script = Script(VirtualClock(), TOOK_S)
    for call in (1, 2, 3):
        script.on("frame_source.acquire", raising(lost()), call=call)
    ended, documents, _ = run(cycle(0), script=script, retries=2)
    assert ended.end is EndReason.BROKEN
    assert "no reply" in ended.detail
    assert len(kinds(documents, StepRetried)) == 2


def test_a_press_is_never_tried_again():
    script = Script(VirtualClock(), TOOK_S)
    script.on("force_applicator.press", raising(lost("force_applicator")))
    ended, documents, _ = run(cycle(0), script=script)
    assert ended.end is EndReason.BROKEN
    assert script.count("force_applicator.press") == 1
    assert kinds(documents, StepRetried, LoadFinished) == []


def test_an_error_that_is_not_retryable_is_not_retried():
    script = Script(VirtualClock(), TOOK_S)
    script.on("frame_source.acquire", raising(InstrumentError("frame_source", "COM3", "burnt")))
    ended, documents, _ = run(cycle(0), script=script)
    assert ended.end is EndReason.BROKEN
    assert kinds(documents, StepRetried) == []


def test_the_head_is_lifted_before_a_surface_search_is_tried_again():
    script = Script(VirtualClock(), TOOK_S)
    script.on("force_applicator.find_surface", raising(lost("force_applicator")))
    assert run((*SET_UP, *cycle(0)), script=script)[0].end is EndReason.FINISHED
    names = [name for name in script.names() if name.startswith("force_applicator")]
    again = names.index("force_applicator.find_surface") + 1
    assert names[again : again + 2] == ["force_applicator.release", "force_applicator.find_surface"]


# --- resuming --------------------------------------------------------------------------------------------


def test_finished_loads_are_not_pressed_again():
    phases = ((*SET_UP, *cycle(0), *cycle(1), *cycle(2)), (*SET_UP, *cycle(3), *cycle(4)))
    done = frozenset({(0, 0), (0, 1), (0, 2), (1, 0)})
    ended, documents, script = run(*phases, done=done, ended=frozenset({0}))
    assert ended.end is EndReason.FINISHED
    (finished,) = kinds(documents, LoadFinished)
    assert (finished.phase, finished.record.index, finished.record.load.label) == (1, 1, "L4")
    assert [d.index for d in kinds(documents, PhaseStarted)] == [1]
    assert [d.index for d in kinds(documents, PhaseFinished)] == [1]
    # The applicator has forgotten its zero and the surfaces; the sheet of the finished phase need not rest, and the
    # unloaded frames of the other one are there.
    assert script.count("force_applicator.home") == 1
    assert script.count("force_applicator.find_surface") == 2
    assert [d.step for d in kinds(documents, StepStarted) if isinstance(d.step, Hold)] == [
        Hold(240, acquire=False), Hold(60, acquire=True), Hold(60, acquire=True), Hold(60, acquire=True)
    ]  # fmt: skip
    assert kinds(documents, Unloaded) == []


def resumed(*phases, done=frozenset(), ended=frozenset()):
    """Steps of a resumed session, as (number, step) by phase."""
    told = schedule(example_plan(*phases), frozenset(done), frozenset(ended))
    return [[(scheduled.number, scheduled.step) for scheduled in phase.steps] for phase in told]


def test_a_phase_that_goes_on_begins_with_its_rest_and_the_rest_before_the_next_load():
    steps = (Home(), *SET_UP, *cycle(0), *cycle(1), *cycle(2))
    ((*left,),) = resumed(steps, done={(0, 0), (0, 1)})
    # Homing, surface, first rest, the rest after the second load (step 12), and the third load, with their numbers.
    assert left == [(number, steps[number]) for number in (0, 1, 2, 12, 13, 14, 15, 16)]
    assert resumed(steps)[0] == list(enumerate(steps))


def test_what_stands_between_finished_loads_is_not_repeated_but_for_surfaces():
    between = (FindSurface(10, 0), MarkUnloaded(), Hold(30, acquire=False))
    steps = (Home(), *cycle(0), *between, *cycle(1), *between, *cycle(2))
    ((*left,),) = resumed(steps, done={(0, 0), (0, 1)})
    assert left == [(number, steps[number]) for number in (0, 5, 11, *range(12, len(steps)))]


def test_a_phase_cut_off_between_its_last_load_and_its_end_only_ends():
    steps = (Home(), *SET_UP, *cycle(0))
    after = (FindSurface(10, 0), Hold(30, acquire=True))
    assert resumed(steps, done={(0, 0)}) == [[(0, Home()), (1, SET_UP[0])]]
    ((*left,),) = resumed((*steps, *after), done={(0, 0)})
    assert left == [(0, Home()), (1, SET_UP[0]), (9, after[0]), (10, after[1])]
    _, documents, _ = run(steps, done=frozenset({(0, 0)}))
    assert [document.index for document in kinds(documents, PhaseFinished)] == [0]
    assert kinds(documents, LoadFinished, Unloaded) == []


def test_a_phase_without_loads_is_not_repeated_once_it_ended():
    phases = ((Home(), AcquireFrames(3)), cycle(0))
    assert resumed(*phases, ended={0})[0] == [(0, Home())]
    assert len(resumed(*phases)[0]) == 2


def test_instruments_with_addresses_are_told_each_step_before_it_begins():
    class Counted(ScriptedInstrument):
        def begin_step(self, phase, number):
            told.append((phase, number, len(kinds(documents, StepStarted))))

    documents, told = [], []
    script = Script(VirtualClock(), TOOK_S)
    plan = example_plan(cycle(0), cycle(1))
    bench = scripted_bench(script, plan.sensor_type)
    counted = Mounted(InstrumentSpec("counted", "scripted", (), {}, None), Counted("counted", script))
    execute(plan, example_identity(), Bench([*bench.mounted, counted]), script.clock, [documents.append])
    steps = [(d.phase, d.number) for d in kinds(documents, StepStarted)]
    assert [place[:2] for place in told] == steps
    assert [count for *_, count in told] == list(range(1, len(steps) + 1))


# --- refusals --------------------------------------------------------------------------------------------


def test_a_plan_that_breaks_limits_touches_nothing():
    script = Script(VirtualClock(), TOOK_S)
    told = []
    with pytest.raises(RefusedError, match="strain"):
        run(cycle(0, strain=0.5), script=script, journal=told.append)
    assert (script.calls, told) == ([], [])


def test_prompts_are_asked_or_refused():
    asked = []
    ended, _, _ = run((Prompt("turn the sheet"), *cycle(0)), ask=asked.append)
    assert ended.end is EndReason.FINISHED
    assert asked == ["turn the sheet"]
    with pytest.raises(RefusedError, match="nobody is there"):
        run((Prompt("turn the sheet"), *cycle(0)))


def test_a_frame_source_outside_the_clock_is_found_out():
    script = Script(VirtualClock(), TOOK_S)
    plan = example_plan(cycle(0))
    bench = scripted_bench(script, plan.sensor_type)
    inner = bench.frame_source.acquire
    bench.frame_source.acquire = lambda count: _without_time(script, inner, count)
    ended = execute(plan, example_identity(), bench, script.clock, [lambda event: None])
    assert ended.end is EndReason.BROKEN
    assert "took no time" in ended.detail


def test_frames_of_another_shape_are_refused():
    script = Script(VirtualClock(), TOOK_S)
    plan = example_plan(cycle(0))
    bench = scripted_bench(script, plan.sensor_type)
    inner = bench.frame_source.acquire
    bench.frame_source.acquire = lambda count: inner(2)
    ended = execute(plan, example_identity(), bench, script.clock, [lambda event: None])
    assert ended.end is EndReason.BROKEN
    assert "frames of shape (2, 16, 16) came; (1, 16, 16) was asked for" in ended.detail


def _without_time(script, acquire, count):
    now = script.clock.now()
    frames = acquire(count)
    script.clock._now = now
    return frames


def test_real_and_virtual_clock_run_the_same_code():
    # Short enough to wait for: 0.12 s of holds on the computer's clock.
    steps = (Press(load()), Hold(0.06, acquire=True), Release(), Hold(0.06, acquire=True))
    plan = example_plan(steps)
    told = {}
    for clock in (VirtualClock(), RealClock()):
        script = Script(clock)
        documents = told[type(clock)] = []
        bench = scripted_bench(script, plan.sensor_type, frame_period_s=0.02)
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
    mounted = {one.spec.role: one.instrument for one in scripted_bench(script, example_plan([]).sensor_type).mounted}
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
    with pytest.raises(ConfigError, match=r"by a .* and by d"):
        Bench([frames, head, cell, Mounted(spec("d", "frame_source"), by_role["frame_source"])])
    with pytest.raises(ConfigError, match="provides 'force_applicator'"):
        Bench([frames, cell])
    with pytest.raises(ConfigError, match="samples 'force'"):
        Bench([frames, head])
    with pytest.raises(ConfigError, match="channel 'force' is sampled by"):
        Bench([frames, head, cell, Mounted(spec("d", "second_force"), parts()[1]["load_cell"])])
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
