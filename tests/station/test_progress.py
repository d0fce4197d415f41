"""Progress: a bar on a terminal, one line a phase elsewhere, nothing ever on stdout."""

import io
from dataclasses import astuple

import numpy as np
import pytest

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan.steps import AcquireFrames, Hold, Press, Release
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import FramesTaken, PhaseStarted, RunStarted, StepStarted
from cbsr_qa.station.control.status import RunStatus
from cbsr_qa.station.execution import execute
from cbsr_qa.station.noise import NoiseSoFar
from cbsr_qa.station.plan import PlannedPhase
from cbsr_qa.station.progress import RunProgress
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa.testing.bench import FixedSequence, Script, example_identity, example_plan, make_scripted_bench, raising

PRESS = Press(Load("L0", 0, 0, 0.2, 0))
CYCLE = FixedSequence((PRESS, Hold(60, acquire=True), Release(), Hold(60, acquire=True)))


class Terminal(io.StringIO):
    def isatty(self):
        return True


class SlowTerminal(Terminal):
    def write(self, text):
        raise OSError("gone")


def planned(plan):
    status = RunStatus(None)
    presses = [((phase, 0), PRESS) for phase in range(len(plan.phases))]
    status.plan({n: phase.name for n, phase in enumerate(plan.phases)}, presses, frozenset())
    return status


def shown(stream, *, script=None, listeners=()):
    script = script or Script(VirtualClock())
    plan = example_plan(*(PlannedPhase(f"[bold]{name}", "fixed", CYCLE) for name in ("first", "second")))
    bench = make_scripted_bench(script, plan.sensor_type)
    warnings = []
    status = planned(plan)
    with RunProgress(len(plan.phases), script.clock, status, stream=stream) as progress:
        subscribers = [lambda event: None, status, progress, *listeners]
        execute(plan, example_identity(), bench, script.clock, subscribers, warn=warnings.append)
    return warnings


def test_without_a_terminal_there_is_one_line_a_phase_and_a_press(capsys):
    stream = io.StringIO()
    assert shown(stream) == []
    first, press, second, other = stream.getvalue().splitlines()
    assert press.startswith("press 1 of 2, L0 at (0, 0) mm, ")
    assert press.endswith(" N, 3 min left")
    assert other.startswith("press 2 of 2, L0 at (0, 0) mm, ")
    assert first.startswith("[bold]first (1 of 2): 4 min of station time left")
    assert second.startswith("[bold]second (2 of 2): 2 min of station time left")
    assert capsys.readouterr() == ("", "")


def test_by_default_it_goes_to_stderr_alone(capsys):
    shown(None)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 4


def test_a_retry_is_said():
    script = Script(VirtualClock())
    script.on("frame_source.acquire", raising(InstrumentError("mux", "COM3", "no reply", retryable=True)))
    stream = io.StringIO()
    shown(stream, script=script)
    assert "attempt 1 failed, retrying: mux at COM3: no reply" in stream.getvalue()


def test_on_a_terminal_phase_and_doing_are_plain_text_and_the_bar_goes_away(capsys):
    stream = Terminal()
    assert shown(stream) == []
    assert capsys.readouterr() == ("", "")
    text = stream.getvalue()
    assert "[bold]second" in text
    assert text.endswith("\x1b[2K")  # the line is erased


@pytest.mark.parametrize(
    ("clock", "said"), [(VirtualClock(), "50 %"), (RealClock(), "3 min left"), (VirtualClock(speed=50.0), "4 s left")]
)
def test_time_left_is_in_real_time_and_percent_of_a_clock_that_does_not_wait(clock, said):
    stream = Terminal()
    with RunProgress(2, clock, RunStatus(None), stream=stream) as progress:
        progress(RunStarted(example_identity()))
        progress(PhaseStarted(0, "first", "fixed", clock.now()))
        progress(StepStarted(0, 0, Release(), clock.now(), 400.0))
        progress(StepStarted(0, 1, Release(), clock.now(), 200.0))
    assert said in stream.getvalue()


def test_a_terminal_that_went_away_does_not_stop_the_run():
    kinds = []
    (warning,) = shown(SlowTerminal(), listeners=[lambda event: kinds.append(type(event).__name__)])
    assert "gone" in warning
    assert kinds[-1] == "RunEnded"


def test_the_bar_makes_room_while_somebody_is_asked():
    stream, seen = Terminal(), []
    plan = example_plan(PlannedPhase("first", "fixed", CYCLE))
    script = Script(VirtualClock())
    with RunProgress(1, script.clock, RunStatus(None), stream=stream) as progress:

        def asking():
            with progress.pause():
                seen.append(progress._bar._bar.live.is_started)
            seen.append(progress._bar._bar.live.is_started)

        script.on("force_applicator.press", asking)
        execute(plan, example_identity(), make_scripted_bench(script, plan.sensor_type), script.clock, [progress])
    with progress.pause():
        seen.append(progress._bar)
    assert seen == [False, True, None]


def test_noise_is_pooled_over_steps_without_the_drift_between_them():
    noise, random = NoiseSoFar(), np.random.default_rng(23)
    for number, mean in enumerate((1.0, 1.5)):
        noise(StepStarted(0, number, AcquireFrames(400), 0.0, 0.0))
        voltages = mean + 0.003 * random.standard_normal((400, 4, 5))
        flags = np.zeros(voltages.shape, dtype=np.uint8)
        noise(FramesTaken(0, FrameBlock(np.arange(400.0), voltages, flags, VoltageUnit.VOLT, None)))
    assert noise.percent == pytest.approx(100 * 0.003 / 1.5, rel=0.03)
    noise(StepStarted(0, 2, PRESS, 0.0, 0.0))
    noise(StepStarted(0, 3, AcquireFrames(1), 0.0, 0.0))
    before = noise.percent
    noise(FramesTaken(0, FrameBlock(np.arange(400.0), 9 * voltages, flags, VoltageUnit.VOLT, None)))
    assert noise.percent == before


def test_a_press_is_under_way_until_its_rest_has_ended_then_the_next_one_is_named(capsys):
    seen = []

    def look(event):
        now = status.now()
        seen.append((type(event).__name__, now.load and now.load.number, now.next and astuple(now.next)))

    plan = example_plan(*(PlannedPhase(name, "fixed", CYCLE) for name in ("first", "second")))
    status, clock = planned(plan), VirtualClock()
    bench = make_scripted_bench(Script(clock), plan.sensor_type)
    execute(plan, example_identity(), bench, clock, [lambda event: None, status, look])
    assert seen[0] == ("RunStarted", None, (1, 2))
    finished = [where[1:] for where in seen if where[0] == "LoadFinished"]
    assert finished == [(None, (2, 2)), (None, None)]
    assert {where[1:] for where in seen if where[0] == "FramesTaken"} == {(1, None), (2, None)}
