"""Faults at any calls: the head is up, the bench safe, and the record consistent."""

import signal

from drawn import drawn
from hypothesis import given, strategies as st
from stopping import CYCLE, LOAD, SAFE, run, send

from cbsr_qa.domain.errors import AbortedError, InstrumentError
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, StrainStep
from cbsr_qa.domain.run.events import LoadFinished, RunEnded, RunStarted, StepStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import Script, raising

STEPS = (
    FindSurface(0, 0), Hold(6, acquire=False), MarkUnloaded(), AcquireFrames(2), *CYCLE, Press(LOAD), StrainStep(0.3),
    Hold(5, acquire=True), Release(), Hold(5, acquire=False),
)  # fmt: skip
TOOK_S = {
    "force_applicator.home": 6.0,
    "force_applicator.find_surface": 9.0,
    "force_applicator.move_to": 3.0,
    "force_applicator.press": 3.5,
    "force_applicator.release": 3.25,
}
NUMBER_OF_CALLS = len(run(STEPS, script=Script(VirtualClock(), TOOK_S))[2].calls)
ACTIONS = {
    "lost": lambda: raising(InstrumentError("some_role", "COM3", "no reply", retryable=True)),
    "broken": lambda: raising(InstrumentError("some_role", "COM3", "burnt")),
    "bug": lambda: raising(ZeroDivisionError("in a driver")),
    "interrupted": lambda: raising(KeyboardInterrupt()),
    "aborted": lambda: raising(AbortedError("the foreman")),
    "SIGINT": lambda: send(signal.SIGINT),
    "SIGTERM": lambda: send(signal.SIGTERM),
    "SIGHUP twice": lambda: send(signal.SIGHUP, 2),
}


@drawn(300)
@given(faults=st.dictionaries(st.integers(3, NUMBER_OF_CALLS + 3), st.sampled_from(sorted(ACTIONS)), max_size=5))
def test_whatever_happens_the_head_is_up_the_bench_safe_and_the_record_consistent(faults):
    """Faults at any calls, also in the safe state: every instrument is told it all the same, in its turn, at once."""
    script = Script(VirtualClock(), TOOK_S)
    for number, action in faults.items():
        script.do_at(number, ACTIONS[action]())
    ended, told, script, bench, _ = run(STEPS, script=script)
    names = script.names()
    assert names[-3:] == SAFE
    first_safe = len(names) - 3
    in_safe_state = {action for number, action in faults.items() if number >= first_safe}
    failed = in_safe_state & {"lost", "broken", "bug", "interrupted", "aborted"}
    assert ("NOT SAFE" in ended.detail) == bool(failed & {faults.get(first_safe + k) for k in range(3)})
    if faults.get(first_safe) not in failed:
        assert not bench.force_applicator.down
    assert_consistent(ended, told, script)
    before = [faults[number] for number in sorted(faults) if number < first_safe]
    if not before and "NOT SAFE" not in ended.detail:
        assert ended.end is EndReason.FINISHED


def assert_consistent(ended, told, script):
    """One first document, one last; times that do not go back; every press with its rest, or none."""
    assert [isinstance(one, RunStarted) for one in told].count(True) == isinstance(told[0], RunStarted)
    assert told[-1] is ended
    assert sum(isinstance(one, RunEnded) for one in told) == 1
    times = [one.time_s for one in told if isinstance(one, StepStarted | RunEnded)]
    assert times == sorted(times)
    assert sum(seconds for _, seconds in ended.spent) <= ended.time_s + 1e-6
    finished = [one.record for one in told if isinstance(one, LoadFinished)]
    assert [record.index for record in finished] == list(range(len(finished)))
    for record in finished:
        stamps = (record.press_start_s, record.hold_start_s, record.release_start_s, record.release_end_s)
        assert list(stamps) == sorted(stamps)
        assert record.rest_end_s >= record.release_end_s
    safe_s = [call.time_s for call in script.calls if call.name.endswith("safe_state")][-3:]
    last_s = max(call.time_s for call in script.calls if not call.name.endswith("safe_state"))
    # From the last thing that was asked of the bench, its own time included.
    assert max(safe_s) - last_s <= max(TOOK_S.values()) + 1.0
    if ended.end is EndReason.FINISHED:
        assert ended.detail == ""
    else:
        assert (
            "(phase 'phase 0', step" in ended.detail
            or "before the first step" in ended.detail
            or (ended.detail.startswith("NOT SAFE"))
        )
