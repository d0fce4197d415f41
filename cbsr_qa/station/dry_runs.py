"""Dry run: duration, travel, strain and force of a plan, and violations of the station's limits."""

import copy
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.domain.plan.plan import Motion
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
    Step,
    StrainStep,
    TouchPlane,
)
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.station.limits import (
    Violation,
    clearance_violations,
    dwell_violations,
    highest_force_N,
    load_violations,
    place_violations,
    strain_violations,
)
from cbsr_qa.station.plan import (
    Activity,
    LoadKey,
    Plan,
    ScheduledPhase,
    ScheduledStep,
    Spent,
    describe,
    duration,
    frames_in_hold,
    schedule,
    split_presses,
)

#: Touches that give a plane.
_PLANE: Final = 3


@dataclass(frozen=True, slots=True)
class DryPhase:
    """Expected time and content of one phase.

    Parameters
    ----------
    durations_s : expected duration of each scheduled step.
    frames : number; of a phase that decides with its most presses.
    """

    scheduled: ScheduledPhase
    durations_s: tuple[float, ...]
    frames: int

    @property
    def duration_s(self) -> float:
        """Expected duration; of a phase that decides with its most presses [s]."""
        return sum(self.durations_s[: len(select_counted_steps(self.scheduled))])

    @property
    def presses(self) -> int:
        """Number of presses; of a phase that decides the most that are left."""
        return sum(isinstance(scheduled.step, Press) for scheduled in select_counted_steps(self.scheduled))

    def duration_with_s(self, presses: int) -> float:
        """Expected duration of a phase that decides with a number of presses, those of earlier sessions included."""
        return sum(self.durations_s[: len(select_counted_steps(self.scheduled, presses))])


def select_counted_steps(scheduled: ScheduledPhase, presses: int | None = None) -> tuple[ScheduledStep, ...]:
    """Return the steps that take time: all, but of a phase that decides those of its most presses, in listed order.

    Parameters
    ----------
    presses : number instead of the most, those of earlier sessions included.
    """
    if scheduled.goal is None or scheduled.finished:
        return scheduled.steps
    before, by_load = split_presses(scheduled.steps)
    left = max((scheduled.goal.at_most if presses is None else presses) - scheduled.pressed, 0)
    return (*before, *chain.from_iterable(list(by_load.values())[:left]))


@dataclass(frozen=True, slots=True)
class DryRun:
    """Expected duration and extent of a plan, and its violations.

    Parameters
    ----------
    peak_strain, peak_force_N : highest requested strain, and highest expected force; 0 without loads.
    violations : every broken limit once, in words, with the first step that breaks it; empty if the plan may run.
    sooner_s : by how much rests that end when the sheet is stable may shorten the run.
    """

    phases: tuple[DryPhase, ...]
    spent: tuple[tuple[str, float], ...]
    travel_mm: float
    loads: int
    frames: int
    peak_strain: float
    peak_force_N: float
    violations: tuple[str, ...]
    sooner_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """Longest duration."""
        return sum(seconds for _, seconds in self.spent)

    def refuse(self) -> None:
        """Refuse a plan that violates limits. RefusedError listing every violation."""
        if self.violations:
            listed = "\n".join(f"  {violation}" for violation in self.violations)
            raise RefusedError(
                f"the recipe exceeds what this station allows:\n{listed}",
                remedy="change the recipe's options, or the station's [safety] limits if the bench can take it",
            )


def dry_run(
    plan: Plan,
    frame_period_s: float,
    *,
    done: Collection[LoadKey] = (),
    ended: frozenset[int] = frozenset(),
    answered: bool = True,
) -> DryRun:
    """Walk a plan's steps by arithmetic alone.

    RefusedError if the plan has no phase, or a sequence yields no steps or endless ones. Violated limits are listed
    in the result; :meth:`DryRun.refuse` raises for them. PluginError if a sequence's role is invalid. ``done`` and
    ``ended``: loads and phases finished in an earlier session of the same run.
    """
    walk = _DryWalk(plan, frame_period_s, answered)
    phases = tuple(walk.phase(scheduled) for scheduled in schedule(plan, done, ended))
    walk.finish()
    return DryRun(
        phases,
        walk.spent.table(),
        walk.travel_mm,
        sum(phase.presses for phase in phases),
        sum(p.frames for p in phases),
        walk.peak_strain,
        walk.peak_force_N,
        walk.violations(),
        walk.sooner_s,
    )


@dataclass(slots=True)
class _DryWalk:
    """Simulated position of the head, and totals so far."""

    plan: Plan
    frame_period_s: float
    answered: bool
    spent: Spent = field(default_factory=Spent)
    travel_mm: float = 0.0
    peak_strain: float = 0.0
    peak_force_N: float = 0.0
    #: Violation → the first step that causes it, and the number of later ones.
    broken: dict[str, tuple[str, int]] = field(default_factory=dict)
    place_mm: tuple[float, float] = (0.0, 0.0)
    depth_mm: float | None = None  #: None while the head is up
    load: Load | None = None  #: pressed last
    down_s: float = 0.0  #: station time when the head was down
    dwelt: bool = False  #: this press was down for too long, as already reported
    frames: int = 0
    sooner_s: float = 0.0
    clearance_mm: float | None = None  #: that this phase lowers the hover height to
    height_mm: float | None = None  #: of the head that is up; None: the station's hover height
    touches: int = 0  #: of a plane; with three the highest point of the surface is known

    def phase(self, scheduled: ScheduledPhase) -> DryPhase:
        self.frames = 0
        self.clearance_mm = None
        counted = select_counted_steps(scheduled)
        durations_s = self._walk(scheduled, counted)
        if self.depth_mm is not None:
            self._note(f"phase {scheduled.name!r} ends with the head down")
        # Presses beyond the most may be chosen instead: they are checked too, and take no more time.
        others = replace(self, spent=copy.deepcopy(self.spent))
        durations_s += others._walk(scheduled, scheduled.steps[len(counted) :])
        return DryPhase(scheduled, tuple(durations_s), self.frames)

    def _walk(self, scheduled: ScheduledPhase, steps: tuple[ScheduledStep, ...]) -> list[float]:
        durations_s = []
        for step in steps:
            before_s = self.spent.total_s()
            for violation in chain(self._step(step), self._dwell()):
                self._note(violation.what, f"phase {scheduled.name!r}, {describe(step.step)}: ")
            durations_s.append(self.spent.total_s() - before_s)
        return durations_s

    def finish(self) -> None:
        total_s, allowed_s = self.spent.total_s(), self.plan.safety.duration_s
        if not total_s <= allowed_s:
            self._note(f"the run takes {duration(total_s)}; the station allows {duration(allowed_s)}")

    def violations(self) -> tuple[str, ...]:
        """Return every broken limit once, with the first step that breaks it and how many later ones do."""
        return tuple(
            f"{place}{violation}" + (f" (also at {later} later step{'s' * (later > 1)})" if later else "")
            for violation, (place, later) in self.broken.items()
        )

    def _note(self, what: str, where: str = "") -> None:
        first_place, later = self.broken.get(what, (where, -1))
        self.broken[what] = first_place, later + 1

    def _step(self, scheduled: ScheduledStep) -> Iterator[Violation]:
        step = scheduled.step
        if isinstance(step, Home | FindSurface | Press) and self.depth_mm is not None:
            yield Violation("order", "the head is still down")
        match step:
            case Press(load=load):
                yield from load_violations(load, self.plan)
                self._press(load)
            case StrainStep(strain=strain):
                yield from self._ease(strain)
            case FindSurface(x_mm=x_mm, y_mm=y_mm):
                yield from place_violations(x_mm, y_mm, self.plan)
                self._travel(x_mm, y_mm)
                self.spent.add(Activity.SURFACE, kinematics.surface_search_s(self._motion))
                self.touches += isinstance(step, TouchPlane)
            case LowerHover(clearance_mm=clearance_mm):
                yield from clearance_violations(clearance_mm, self.plan)
                self.clearance_mm = clearance_mm
            case Release():
                if self.depth_mm is None:
                    yield Violation("order", "the head is not down")
                self.spent.add(Activity.RELEASE, kinematics.stroke_s(self._motion, self.depth_mm or 0.0))
                self.depth_mm = None
            case Hold():
                yield from self._hold(step)
            case _:
                yield from self._dry_run_other(step)

    def _dry_run_other(self, step: Step) -> Iterator[Violation]:
        match step:
            case Home():
                self.spent.add(
                    Activity.HOME, kinematics.homing_s(self.plan.motion, self.plan.safety.travel_radius_mm)
                )
                self.place_mm, self.height_mm = (0.0, 0.0), None
            case AcquireFrames(count=count):
                if count < 1:
                    yield Violation("order", f"{count} frames; at least 1 is needed")
                self.frames += max(count, 0)
                self.spent.add(Activity.FRAMES, max(count, 0) * self.frame_period_s)
            case MarkUnloaded():
                if self.depth_mm is not None:
                    yield Violation("order", "the head is down, so the sheet is not unloaded")
            case Prompt():
                if not self.answered:
                    yield Violation("order", "no operator is present to answer")
            case _:
                yield Violation("order", f"this runner does not know steps of type {type(step).__name__}")

    def _dwell(self) -> Iterator[Violation]:
        """Yield a violation of the hold time, once per press."""
        if self.depth_mm is not None and not self.dwelt:
            for violation in dwell_violations(self.spent.total_s() - self.down_s, self.plan):
                self.dwelt = True
                yield violation

    def _press(self, load: Load) -> None:
        depth_mm = load.strain * self.plan.sensor_type.thickness_mm
        self._travel(load.x_mm, load.y_mm)
        self.spent.add(Activity.PRESS, kinematics.stroke_s(self._motion, depth_mm))
        self.load = load
        self._down(load.strain)
        self.down_s, self.dwelt = self.spent.total_s(), False

    def _ease(self, strain: float) -> Iterator[Violation]:
        if self.depth_mm is None or self.load is None:
            yield Violation("order", "the head is not down")
            return
        yield from strain_violations(strain, self.plan)  # its place was checked when it was pressed
        to_mm = strain * self.plan.sensor_type.thickness_mm
        self.spent.add(Activity.PRESS, kinematics.ease_s(self.plan.motion, self.depth_mm, to_mm))
        self._down(strain)

    def _down(self, strain: float) -> None:
        self.depth_mm = strain * self.plan.sensor_type.thickness_mm
        self.peak_strain = max(self.peak_strain, strain)
        self.peak_force_N = max(self.peak_force_N, highest_force_N(strain, self.plan))

    def _hold(self, step: Hold) -> Iterator[Violation]:
        kind = Activity.REST if self.depth_mm is None else Activity.HOLD
        if not 0 <= step.hold_s < float("inf"):
            yield Violation("order", f"hold_s is {step.hold_s}; it must be finite and at least 0")
            return
        if isinstance(step, Settle):
            window_s = kinematics.SETTLE_FRAMES * self.frame_period_s
            self.sooner_s += max(step.hold_s - max(step.least_s, window_s), 0.0)
        if not step.acquire:
            self.spent.add(kind, step.hold_s)
        else:
            count = frames_in_hold(step.hold_s, self.frame_period_s)
            self.frames += count
            self.spent.add(kind, max(step.hold_s, count * self.frame_period_s))

    @property
    def _motion(self) -> Motion:
        """The station's, with the hover height as it is lowered now."""
        if self.clearance_mm is None:
            return self.plan.motion
        above_mm = self.clearance_mm + (0.0 if self.touches >= _PLANE else kinematics.SEARCH_FROM_MM)
        return replace(self.plan.motion, hover_mm=min(above_mm, self.plan.motion.hover_mm))

    def _travel(self, x_mm: float, y_mm: float) -> None:
        motion = self._motion
        distance_mm = kinematics.distance_mm(self.place_mm, (x_mm, y_mm))
        self.travel_mm += distance_mm
        height_mm = self.plan.motion.hover_mm if self.height_mm is None else self.height_mm
        self.spent.add(Activity.TRAVEL, kinematics.travel_s(motion, distance_mm + abs(height_mm - motion.hover_mm)))
        self.height_mm = motion.hover_mm
        self.place_mm = (x_mm, y_mm)
