"""The runner: what is tried again, and what a resumed run leaves out."""

import pytest
from runner_samples import SET_UP, TOOK_S, cycle, kinds, lost, run

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Home, MarkUnloaded
from cbsr_qa.domain.run.events import LoadFinished, PhaseFinished, PhaseStarted, StepRetried, StepStarted, Unloaded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.bench import Bench, Mounted
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import schedule
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import (
    Script,
    ScriptedInstrument,
    example_identity,
    example_plan,
    make_scripted_bench,
    raising,
)

# --- retries ---------------------------------------------------------------------------------------------


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
    assert [d.phase for d in kinds(documents, PhaseFinished)] == [1]
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
    assert [document.phase for document in kinds(documents, PhaseFinished)] == [0]
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
    bench = make_scripted_bench(script, plan.sensor_type)
    counted = Mounted(InstrumentSpec("counted", "scripted", (), {}, None), Counted("counted", script))
    execute(plan, example_identity(), Bench([*bench.mounted, counted]), script.clock, [documents.append])
    steps = [(d.phase, d.number) for d in kinds(documents, StepStarted)]
    assert [place[:2] for place in told] == steps
    assert [count for *_, count in told] == list(range(1, len(steps) + 1))
