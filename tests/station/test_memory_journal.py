"""A run kept in memory is the run that the database gives back."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from calibration_samples import assert_same

from cbsr_qa.domain.plan.steps import AcquireFrames, Hold, Home, MarkUnloaded, Press, Release, Role, StrainStep
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.documents import MemoryJournal
from cbsr_qa.station.execution import execute
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.store.opening import open_store
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import FixedSequence, Script, example_identity, example_plan, make_scripted_bench

HELD = Hold(10.0, acquire=True)


def press(label, *more):
    return (Press(Load(label, 15.0, 0.0, 0.2, 0)), HELD, *more, Release(), HELD)


LOOP = (StrainStep(0.3), HELD, StrainStep(0.2), HELD)
REST = (Hold(30.0, acquire=False), MarkUnloaded(), AcquireFrames(3))


def planned():
    """Phases without frames, with a role, with a press that is eased, and with two rests."""
    return example_plan(
        PlannedPhase("home", "fixed", FixedSequence((Home(),))),
        PlannedPhase("grid", "fixed", FixedSequence((*REST, *press("A"), *press("B")), Role.GRID)),
        PlannedPhase("loop", "fixed", FixedSequence((*REST, *press("L", *LOOP), *REST, *press("C")))),
    )


def executed(plan, store):
    """Run a plan with both journals listening; return what each makes of it."""
    script = Script(VirtualClock())
    bench = make_scripted_bench(script, plan.sensor_type)
    identity = replace(
        example_identity(),
        run=store.new_id(),
        started_at=datetime(2026, 11, 21, tzinfo=UTC),
        configuration_digest="44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a",  # of {}
    )
    stored = store.open_journal(
        configuration="{}", sensor_type=plan.sensor_type, material=plan.material, indenter=plan.indenter
    )
    kept = MemoryJournal(plan)
    ended = execute(plan, identity, bench, script.clock, [stored, kept])
    return store.runs.load(identity.run), kept.record(identity, ended)


@pytest.fixture
def store(tmp_path):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as opened:
        yield opened


def test_memory_gives_what_the_database_gives(store):
    stored, kept = executed(planned(), store)
    home, grid, loop = kept.phases
    assert (home.frames, home.loads, home.unloaded_from_s) == (None, (), None)
    assert (len(grid.loads), grid.loops, grid.role) == (2, (), Role.GRID)
    assert [load.load.label for load in loop.loops] == ["L"]
    assert [load.load.label for load in loop.loads] == ["C"]
    assert len(grid.frames.time_s) > 3
    assert loop.unloaded_from_s > loop.loops[0].release_end_s  # the latest rest counts
    assert kept.end is EndReason.FINISHED
    assert_same(
        kept, replace(stored, sessions=(), chain=kept.chain, chain_head=kept.chain_head), "run"
    )  # only what is stored
