"""Execution of single steps on the bench."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.domain.plan.steps import (
    AcquireFrames,
    FindSurface,
    Hold,
    Home,
    LowerHover,
    MarkUnloaded,
    Press,
    Prompt,
    Release,
    Settle,
    StrainStep,
)
from cbsr_qa.domain.readings.frames import FrameBlock, join_frames
from cbsr_qa.domain.readings.loads import Load, LoadRecord
from cbsr_qa.domain.run.attendance import RunContinued, RunPaused
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, StepRetried, Unloaded
from cbsr_qa.station.bench import FRAME_SOURCE
from cbsr_qa.station.control.desk import ControlDesk
from cbsr_qa.station.limits import Limits
from cbsr_qa.station.load_log import LoadLog
from cbsr_qa.station.noise import relative_drift
from cbsr_qa.station.plan import Activity, ScheduledStep, Spent, ends_rest, is_frame_worthwhile
from cbsr_qa.station.safety import State, UnderWay, Watch
from cbsr_qa.system.clock import passing

if TYPE_CHECKING:
    from cbsr_qa.station.surface import SheetSurface

T = TypeVar("T")

#: Pause before an operation that failed is tried again [s]; two of them must leave the bench safe within a second.
RETRY_PAUSE_S: Final = 0.25
#: Remainder of a hold at which it counts as over: below the resolution of any clock after hours [s].
_OVER_S: Final = 1e-9
#: Longest computation between two presses on a busy computer [s].
_COMPUTES_S: Final = 120.0

#: Function that shows a text, and a picture if there is one, and returns when it is answered.
Ask = Callable[..., object]


class Performer:
    """Executes steps on the bench: emits events, obeys the interlock.

    Parameters
    ----------
    retries : most repetitions of an operation that failed retryably.
    ask : function that shows a prompt and returns when it is answered; None without an operator.
    surface : what is known of the sheet's surface; None for recipes that leave it to the applicator.
    """

    def __init__(
        self,
        run: UnderWay,
        *,
        retries: int,
        ask: Ask | None,
        surface: "SheetSurface | None" = None,
    ) -> None:
        self.spent = Spent()
        self._plan, self._bench, self._clock, self._documents = run.plan, run.bench, run.clock, run.documents
        self._interlock, self._interrupts, self._watchdog = run.interlock, run.interrupts, run.watchdog
        self._limits = Limits(run.plan, run.clock.now())
        self._watch = Watch(run, self._limits, self._attempt)
        self._head = run.bench.name_of(run.bench.force_applicator)
        self._retries = retries
        self._ask = ask
        self._surface = surface
        self._rest: Hold | None = None
        self._loads = LoadLog()
        self._at = ScheduledStep(0, 0, Home(), None)

    def perform(self, scheduled: ScheduledStep) -> None:
        """Execute one step.

        After an InstrumentError, SafetyError or AbortedError the bench is left as it is, for the caller to stop.
        """
        self._begin(scheduled)
        match scheduled.step:
            case Press(load=load):
                self._press(load)
            case StrainStep(strain=strain):
                self._ease(strain)
            case Hold() as hold:
                self._hold(hold)
            case Release():
                self._release()
            case AcquireFrames(count=count):
                with self.spent.on(Activity.FRAMES, self._clock):
                    for _ in range(count):
                        self._take_frame()
            case MarkUnloaded():
                self._documents.emit(Unloaded(scheduled.phase, self._clock.now()))
            case _:
                self._set_up(scheduled)
        self._look()

    def _begin(self, scheduled: ScheduledStep) -> None:
        if ends_rest(scheduled.step):
            self.finish_load()
        if self._surface is not None and scheduled.phase != self._at.phase:
            self._surface.lower_hover(None)
        self._at = scheduled
        self._bench.begin_step(scheduled.phase, scheduled.number)

    def retreat(self) -> None:
        """Lift a head that is down and still as after any press, before the bench is made safe."""
        if self._interlock.state is State.PRESSED:
            with (
                self.spent.on(Activity.RELEASE, self._clock),
                self._interlock.passing(State.RELEASING, State.ARMED),
            ):
                self._lift()

    def pause(self, before: ScheduledStep, desk: ControlDesk) -> bool:
        """Wait with the head up until somebody continues the run; limits are watched. False if no pause is requested.

        The rest of the last load ends here for its record: a run that is killed in a pause does not repeat it.
        """
        self.finish_load()
        start_s = self._clock.now()
        asker = desk.pause_wanted()
        if asker is None:
            return False
        self._at = before
        self._documents.emit(RunPaused(before.phase, start_s, asker))
        desk.begin_pause(asker, start_s)
        with self.spent.on(Activity.PAUSE, self._clock):
            while (continued := desk.name_continuer()) is None:
                station_s = self._watch.wait_s()
                with self._watchdog.expect("the station's clock", station_s), self._interrupts.idle():
                    passing(self._clock, desk.wait, station_s)
                if self._watch.is_due():
                    self._look()
        self._documents.emit(RunContinued(before.phase, self._clock.now(), continued))
        return True

    def wait_for(self, what: str, wait: Callable[[float], T]) -> T:
        """Wait for a computation with the head up; it counts as rest, and takes no time of a virtual clock.

        Parameters
        ----------
        wait : called with the present time.
        """
        with (
            self.spent.on(Activity.REST, self._clock),
            self._watchdog.expect(what, _COMPUTES_S),
            self._interrupts.idle(),
        ):
            result = wait(self._clock.now())
        self._look()
        return result

    def load_so_far(self) -> LoadRecord | None:
        """Return the record of a press that was released, as if its rest ended with the release; None before."""
        return replace(self._loads).finish(self._loads.times_s[-1]) if self._loads.times_s else None

    def finish_load(self) -> None:
        """Emit the last load after its rest."""
        record = self._loads.finish(self._clock.now())
        if record is not None:
            self._documents.emit(LoadFinished(self._at.phase, record))

    def _set_up(self, scheduled: ScheduledStep) -> None:
        applicator = self._bench.force_applicator
        match scheduled.step:
            case Home():
                reach_mm = self._plan.safety.travel_radius_mm
                with self.spent.on(Activity.HOME, self._clock):
                    self._move(applicator.home, "homing", kinematics.homing_s(self._plan.motion, reach_mm))
                if self._surface is not None:
                    self._surface.forget()
            case FindSurface(x_mm=x_mm, y_mm=y_mm) as touch:
                depth_mm = self._find_surface(x_mm, y_mm)
                if self._surface is not None:
                    self._surface.add(touch, depth_mm)
            case LowerHover(clearance_mm=clearance_mm):
                assert self._surface is not None  # made for every recipe that has such a step
                self._surface.lower_hover(clearance_mm)
            case Prompt(text=text, picture=picture):
                assert self._ask is not None  # the dry run refuses prompts without an operator
                with self.spent.on(Activity.PROMPT, self._clock), self._interrupts.idle():
                    self._ask(text, picture)

    def _find_surface(self, x_mm: float, y_mm: float) -> float:
        """Return the surface's depth below the hover height [mm]."""
        self._travel(x_mm, y_mm)
        return self._feel(partial(self._bench.force_applicator.find_surface, x_mm, y_mm))

    def _press(self, load: Load) -> None:
        self._limits.check_load(load)
        self._travel(load.x_mm, load.y_mm)
        if self._surface is not None:
            self._surface.expect((load.x_mm, load.y_mm))
        motion = self._plan.motion
        depth_mm = load.strain * self._plan.sensor_type.thickness_mm
        assert self._at.load is not None
        with self._interlock.passing(State.PRESSING, State.PRESSED):
            self._look()  # no press without a live load cell
            self._loads.begin(self._at.load, load, self._clock.now(), kinematics.lift_off_s(motion, depth_mm))
            self._go_down(depth_mm)
        self._loads.mark(self._clock.now())
        if self._surface is not None:
            self._check_contact(load, self._surface)

    def _check_contact(self, load: Load, surface: "SheetSurface") -> None:
        """Find the surface, rest again and press again where a press did not meet the sheet at the plane."""
        self._look()
        place_mm, depth_mm = (load.x_mm, load.y_mm), load.strain * self._plan.sensor_type.thickness_mm
        began_s, down_s = self._loads.times_s
        contact_mm = surface.contact_mm(self._bench.samplers, began_s, down_s, depth_mm)
        why = surface.check_contact(place_mm, contact_mm)
        if not why:
            return
        self._documents.emit(StepRetried(self._at.phase, self._at.number, 1, why))
        self.retreat()
        surface.correct(place_mm, self._find_surface(*place_mm))
        if self._rest is not None:
            self._hold(self._rest)
        self._press(load)

    def _ease(self, strain: float) -> None:
        """Move to another depth under the same limits as a press; a failure is not retried."""
        load, motion = self._loads.load, self._plan.motion
        assert load is not None  # the dry run refuses to ease a head that is up
        self._limits.check_load(replace(load, strain=strain))
        depth_mm = strain * self._plan.sensor_type.thickness_mm
        self._look()
        with self._interlock.passing(State.EASING, State.PRESSED):
            start_s = self._clock.now()
            self._go_down(depth_mm)
        self._loads.ease(strain, start_s, self._clock.now(), kinematics.lift_off_s(motion, depth_mm))

    def _go_down(self, depth_mm: float) -> None:
        """Press, or ease; a failure is not retried, because the head's depth is then unknown."""
        motion = self._plan.motion
        work_s = kinematics.stroke_s(motion, depth_mm)
        with (
            self.spent.on(Activity.PRESS, self._clock),
            self._watchdog.expect(f"{self._head}: pressing", work_s),
        ):
            self._bench.force_applicator.press(depth_mm, motion.press_speed_mm_s)

    def _release(self) -> None:
        self._loads.mark(self._clock.now())
        with (
            self.spent.on(Activity.RELEASE, self._clock),
            self._interlock.passing(State.RELEASING, State.ARMED),
        ):
            # Going up is safe to repeat.
            release = self._bench.force_applicator.release
            self._attempt(release, *self._lifting(), before_another=self._loads.lose_track)
        self._loads.mark(self._clock.now())

    def _lift(self) -> None:
        with self._watchdog.expect(*self._lifting()):
            self._bench.force_applicator.release()

    def _lifting(self) -> tuple[str, float]:
        """Describe a lift for the watchdog, with its longest duration [s]."""
        deepest_mm = self._plan.safety.strain * self._plan.sensor_type.thickness_mm
        return f"{self._head}: lifting the head", kinematics.stroke_s(self._plan.motion, deepest_mm)

    def _travel(self, x_mm: float, y_mm: float) -> None:
        self._limits.check_place(x_mm, y_mm)
        across_mm = 2 * self._plan.safety.travel_radius_mm
        with self.spent.on(Activity.TRAVEL, self._clock):
            move = partial(self._bench.force_applicator.move_to, x_mm, y_mm)
            self._move(move, "travelling", kinematics.travel_s(self._plan.motion, across_mm))
        self._interrupts.poll()  # the next step goes down

    def _move(self, motion: Callable[[], object], what: str, work_s: float) -> None:
        """Move with the head up; before a retry the head is lifted."""
        with self._interlock.passing(State.MOVING, State.ARMED):
            self._attempt(motion, f"{self._head}: {what}", work_s, before_another=self._lift)

    def _feel(self, search: Callable[[], float]) -> float:
        """Let the applicator search the surface; it touches the sheet, so force samples must be fresh.

        The search is one call: while it lasts the driver watches over force and its freshness, and the runner
        checks before and right after it.
        """
        with (
            self.spent.on(Activity.SURFACE, self._clock),
            self._interlock.passing(State.FEELING, State.ARMED),
        ):
            self._look()
            work_s = kinematics.surface_search_s(self._plan.motion)
            what = f"{self._head}: feeling for the surface"
            depth_mm = self._attempt(search, what, work_s, before_another=self._lift)
            self._look()
        return depth_mm

    def _hold(self, hold: Hold) -> None:
        if isinstance(hold, Settle):
            self._settle(hold)
            return
        end_s = self._clock.now() + hold.hold_s
        kind = Activity.HOLD if self._interlock.touching else Activity.REST
        if hold.acquire and kind is Activity.REST:
            self._rest = hold
        with self.spent.on(kind, self._clock):
            if hold.acquire:
                self._take_frame()
                while is_frame_worthwhile(end_s - self._clock.now(), self._bench.frame_source.frame_period_s):
                    self._take_frame()
            self._wait_until(end_s)

    def _settle(self, rest: Settle) -> None:
        """Rest with frames until they are stable, or the time is over."""
        begin_s, period_s = self._clock.now(), self._bench.frame_source.frame_period_s
        usable = self._plan.sensor_type.pattern.usable()
        window: deque[FrameBlock] = deque(maxlen=kinematics.SETTLE_FRAMES)
        with self.spent.on(Activity.REST, self._clock):
            while is_frame_worthwhile(begin_s + rest.hold_s - self._clock.now(), period_s):
                window.append(self._take_frame())
                long_enough = self._clock.now() - begin_s >= rest.least_s and len(window) == window.maxlen
                if long_enough and relative_drift(join_frames(list(window)), usable) < rest.drift:
                    return
            self._wait_until(begin_s + rest.hold_s)

    def _wait_until(self, end_s: float) -> None:
        while (left_s := end_s - self._clock.now()) > _OVER_S:
            pause_s = min(left_s, self._watch.wait_s())
            with self._watchdog.expect("the station's clock", pause_s), self._interrupts.idle():
                self._clock.sleep(pause_s)
            self._look()

    def _take_frame(self) -> FrameBlock:
        source, before_s = self._bench.frame_source, self._clock.now()
        source_name = self._bench.name_of(source)
        block = self._attempt(partial(source.acquire, 1), f"{source_name}: a frame", source.frame_period_s)
        self._check_frame(block, self._clock.now() - before_s)
        self._documents.emit(FramesTaken(self._at.phase, block))
        self._limits.check_frame(block, source_name)  # after the journal has stored it as evidence
        self._look()
        return block

    def _check_frame(self, block: FrameBlock, took_s: float) -> None:
        expected = (1, *self._plan.sensor_type.pattern.shape)
        if block.voltages.shape != expected:
            raise InstrumentError(
                FRAME_SOURCE, "the bench", f"received frames of shape {block.voltages.shape}; requested {expected}"
            )
        if not took_s > 0:  # a hold would never end
            raise InstrumentError(FRAME_SOURCE, "the bench", "a frame took zero time on the station's clock")

    def _look(self) -> None:
        self._watch.look(self._at.phase)
        self._interrupts.poll()

    def _attempt(
        self,
        operation: Callable[[], T],
        what: str,
        work_s: float = 0.0,
        *,
        before_another: Callable[[], object] | None = None,
    ) -> T:
        """Call an instrument under the watchdog, again after retryable failures."""
        attempt = 0
        while True:
            try:
                with self._watchdog.expect(what, work_s):
                    return operation()
            except InstrumentError as error:
                attempt += 1
                if not error.retryable or attempt > self._retries:
                    raise
                self._documents.emit(StepRetried(self._at.phase, self._at.number, attempt, error.reason))
            self._clock.sleep(RETRY_PAUSE_S)
            if before_another is not None:
                before_another()
