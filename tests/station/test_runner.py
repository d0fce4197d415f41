"""The runner: documents in order, the journal first, records of loads."""

import pytest
from runner_samples import SET_UP, TOOK_S, cycle, kinds, load, lost, run

from cbsr_qa.domain.errors import PluginError, StoreError
from cbsr_qa.domain.plan.steps import Hold, Home, Press, Release, Role, StrainStep
from cbsr_qa.domain.run.events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunStarted,
    SamplesTaken,
    StepStarted,
    Unloaded,
)
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import FixedSequence, Script, raising


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
    StrainStep(0.3),
    Hold(30, acquire=True),
    StrainStep(0.2),
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
    assert not any(isinstance(d.step, StrainStep) for d in kinds(documents, StepStarted))
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

    planned = (PlannedPhase("a", "fixed", FixedSequence(cycle(0), Role.GRID)), PlannedPhase("b", "silent", Silent()))
    _, documents, _ = run(*planned)
    assert [d.role for d in kinds(documents, PhaseStarted)] == [Role.GRID, Role.OTHER]


@pytest.mark.parametrize("role", ["grid", None, 3])
def test_a_role_that_is_none_is_refused_before_anything_moves(role):
    script = Script(VirtualClock(), TOOK_S)
    with pytest.raises(
        PluginError, match=r"sequence 'fixed' of phase 'a' has role .*, which is not a Role"
    ) as refused:
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
