"""Which press of a phase is next: decided from the frames of a run up to the last release, and nothing else.

So the same is decided during the run, after it was resumed, and when the stored run is decided again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from cbsr_qa.analysis.run.force_so_far import ForceSoFar
from cbsr_qa.analysis.run.observe import observe_run
from cbsr_qa.calibration.force.expected_error import LoadsThatMatter
from cbsr_qa.calibration.sheet.usual_sheet import order_presses
from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.steps import FindSurface, Hold, Press, Release
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.run import PhaseRecord, PressDecided, RunRecord
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import PressGoal, Reconstruction
from cbsr_qa.station.plan import Plan, ScheduledPhase, ScheduledStep, schedule, split_presses

#: Reasons of decisions: no map yet or too few presses, most gain a second, the target is reached, no more presses.
START, ERROR, TARGET, MOST = "start", "error", "target", "most presses"
#: Digits of a gain that count: mirror images are told apart by their number, not by the last bits.
_DIGITS: Final = 6


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The presses of one phase among which is decided.

    Parameters
    ----------
    loads : presses by their index.
    cost_s : time of one press with everything that belongs to it, without travel [s].
    """

    goal: PressGoal
    loads: dict[int, Load]
    cost_s: float

    @property
    def matter(self) -> LoadsThatMatter:
        return LoadsThatMatter(self.goal.radius_mm, self.goal.strains)

    def places_mm(self, numbers: Sequence[int]) -> Array:
        """Places (n, 2) of presses."""
        return np.array([(self.loads[k].x_mm, self.loads[k].y_mm) for k in numbers])


class PressDecisions:
    """Decides between the presses of a plan.

    Parameters
    ----------
    settings, reconstruction : of the recipe; the images themselves have no influence.

    Raises
    ------
    ConfigError
        If a phase that decides does not calibrate, or lists fewer presses than it may make.
    """

    def __init__(self, plan: Plan, settings: AnalysisSettings, reconstruction: Reconstruction) -> None:
        self._plan, self._settings, self._reconstruction = plan, settings, reconstruction
        self.choices = {
            phase.index: _choice(plan, phase, phase.goal) for phase in schedule(plan) if phase.goal is not None
        }
        for index, choice in self.choices.items():
            name = plan.phases[index].name
            if name not in settings.calibrate_phases:
                raise ConfigError(
                    f"phase {name!r} decides by the force error of the calibration, and does not calibrate",
                    remedy="add its name to calibrate_phases of the recipe",
                )
            if choice.goal.at_most > len(choice.loads):
                raise ConfigError(
                    f"phase {name!r} may make {choice.goal.at_most} presses, and lists {len(choice.loads)}",
                    remedy="list more places, or lower the most presses",
                )

    @classmethod
    def from_configuration(cls, configuration: Configuration, plan: Plan, plugins: Plugins) -> Self:
        """Return the decisions of a recipe; PluginError, ConfigError also for its reconstruction."""
        recipe = configuration.recipe
        method: Reconstruction = create_plugin(
            plugins, Kind.RECONSTRUCTION, recipe.reconstruction, "[reconstruction]"
        )
        return cls(plan, recipe.analysis, method)

    def decide(self, record: RunRecord, phase: int, pressed: int, time_s: float) -> PressDecided:
        """Decide after some presses of a phase.

        Parameters
        ----------
        record : the run, at least up to the release of the last of these presses; later data have no influence.
        time_s : time of the decision, for its document.
        """
        choice, so_far = self.choices[phase], cut_record(record, phase, pressed)
        try:
            run = observe_run(so_far, self._reconstruction, self._settings, over_time=False)
            force = ForceSoFar.learn(run, choice.matter)
        except CbsrError:  # there are no unloaded frames yet, or too few presses
            force = None
        error = None if force is None else force.error(choice.goal.confidence)
        done = {load.index for past in so_far.phases if past.index == phase for load in past.loads}
        left = sorted(choice.loads.keys() - done)
        number, why = None, ERROR
        if error is not None and error.upper_N <= choice.goal.target_N and pressed >= choice.goal.at_least:
            why = TARGET
        elif pressed >= choice.goal.at_most:
            why = MOST
        elif force is None or error is None or pressed < choice.goal.at_least:
            number, why = left[self._start(so_far, choice, choice.places_mm(left))], START
        else:
            after_N = force.expect_after_presses_N(choice.places_mm(left))
            cost_s = choice.cost_s + self._travel_s(so_far, choice.places_mm(left))
            gain = (error.expected_N - after_N) / cost_s
            number = left[int(np.argmax(np.round(gain / np.abs(gain).max(), _DIGITS)))]
        load = None if number is None else choice.loads[number]
        return PressDecided(
            phase=phase,
            pressed=pressed,
            load=number,
            label="" if load is None else load.label,
            x_mm=None if load is None else load.x_mm,
            y_mm=None if load is None else load.y_mm,
            expected_N=None if error is None else error.expected_N,
            upper_N=None if error is None else error.upper_N,
            floor_N=None if error is None else error.floor_N,
            why=why,
            time_s=time_s,
        )

    def _start(self, record: RunRecord, choice: Choice, places_mm: Array) -> int:
        """Return which place would help most on a usual sheet, after all presses that calibrate."""
        pressed_mm = [
            (load.load.x_mm, load.load.y_mm)
            for phase in record.phases
            if phase.name in self._settings.calibrate_phases
            for load in phase.loads
        ]
        (first,), _ = order_presses(
            places_mm,
            choice.matter.places_mm(),
            1,
            pressed_mm=np.array(pressed_mm),
            radius_mm=self._plan.sensor_type.radius_mm,
        )
        return first

    def _travel_s(self, record: RunRecord, places_mm: Array) -> Array:
        """Times (n,) of travel from the last press to places (n, 2) [s]."""
        last = max((load for phase in record.phases for load in phase.loads), key=lambda load: load.press_start_s)
        distances_mm = np.hypot(*(places_mm - np.array([last.load.x_mm, last.load.y_mm])).T)
        return np.array([kinematics.travel_s(self._plan.motion, float(mm)) for mm in distances_mm])

    def decide_again(self, record: RunRecord) -> Iterator[tuple[PressDecided, PressDecided]]:
        """Yield each decision of a stored run, and what its data lead to now."""
        for stored in record.decisions:
            yield stored, self.decide(record, stored.phase, stored.pressed, stored.time_s)


def _choice(plan: Plan, phase: ScheduledPhase, goal: PressGoal) -> Choice:
    _, presses = split_presses(phase.steps)
    loads = {
        number: scheduled.step.load
        for number, steps in presses.items()
        for scheduled in steps
        if isinstance(scheduled.step, Press)
    }
    return Choice(goal, loads, float(np.mean([_cost_s(plan, steps) for steps in presses.values()])))


def _cost_s(plan: Plan, steps: Sequence[ScheduledStep]) -> float:
    """Time of a press with everything that belongs to it, without travel [s]."""
    total_s = 0.0
    for scheduled in steps:
        match scheduled.step:
            case FindSurface():
                total_s += kinematics.surface_search_s(plan.motion)
            case Press(load=load):  # down and up again
                total_s += 2 * kinematics.stroke_s(plan.motion, load.strain * plan.sensor_type.thickness_mm)
            case Hold(hold_s=hold_s):
                total_s += hold_s
            case Release() | _:
                pass
    return total_s


def cut_record(record: RunRecord, phase: int, pressed: int) -> RunRecord:
    """Return a run as it was at the release of the last of some presses of a phase; before the phase without any."""
    phases = [past for past in record.phases if past.index < phase]
    current = next((past for past in record.phases if past.index == phase), None)
    if current is not None and pressed:
        phases.append(_cut_phase(current, pressed))
    return replace(record, phases=tuple(phases), decisions=())


def _cut_phase(phase: PhaseRecord, pressed: int) -> PhaseRecord:
    loads = sorted(phase.loads, key=lambda load: load.press_start_s)[:pressed]
    last = loads[-1]
    loads[-1] = replace(last, rest_end_s=last.release_end_s)
    begin_s, end_s = float("-inf"), last.release_start_s
    return replace(
        phase,
        ended_s=last.release_end_s,
        frames=None if phase.frames is None else phase.frames.select_interval(begin_s, end_s),
        samples=tuple(block.select_interval(begin_s, end_s) for block in phase.samples),
        loads=tuple(sorted(loads, key=lambda load: load.index)),
    )
