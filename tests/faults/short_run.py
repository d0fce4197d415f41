"""The short run over the emulated bench that faults strike: its recipe, plan and steps."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, MarkUnloaded, Press, Release, Role, Step
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.interfaces import Sequence, SequenceContext
from cbsr_qa.station.plan import Plan, ScheduledStep, schedule
from cbsr_qa.station.setup import configure, plan_of

#: Of the campaign: nine places; and of its sample: two of them.
NINE_PLACES, TWO_PLACES = (Path(__file__).with_name(name) for name in ("two-frames.toml", "two-places.toml"))
STATION = "bench-emulated"
SEED = 11

#: Fewer of the rested sheet than a sequence may take: the time of a campaign goes into its other steps. And as many
#: as fit into a hold.
UNLOADED_FRAMES, HELD_FRAMES = 4, 2


@lru_cache
def configuration(recipe: Path) -> Configuration:
    """The emulated bench with a short recipe."""
    return configure(STATION, str(recipe), sensor_type=None, material=None, seed=SEED)


class FewerFrames:
    """A sequence that takes :data:`UNLOADED_FRAMES` wherever another takes more."""

    def __init__(self, other: Sequence) -> None:
        self._other = other
        self.role = getattr(other, "role", Role.OTHER)

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the other's steps."""
        for step in self._other.steps(context):
            fewer = isinstance(step, AcquireFrames) and step.count > UNLOADED_FRAMES
            yield AcquireFrames(UNLOADED_FRAMES) if fewer else step


def plan_for(recipe: Path) -> Plan:
    """What a recipe asks of the bench, with few frames of the rested sheet."""
    plan = plan_of(configuration(recipe), plugins())
    return replace(plan, phases=tuple(replace(phase, sequence=FewerFrames(phase.sequence)) for phase in plan.phases))


@lru_cache
def plugins() -> Plugins:
    """Every installed plugin."""
    return discover()


@lru_cache
def steps_of_a_run(recipe: Path = NINE_PLACES) -> tuple[str, ...]:
    """What every step of the run does, in words."""
    (phase,) = schedule(plan_for(recipe))
    return tuple(_words(step.step, pressed) for step, pressed in _with_head(phase.steps))


def _with_head(steps: Iterable[ScheduledStep]) -> Iterator[tuple[ScheduledStep, bool]]:
    down = False
    for step in steps:
        down = isinstance(step.step, Press) or (down and not isinstance(step.step, Release))
        yield step, down


def _words(step: Step, pressed: bool) -> str:
    match step:
        case Hold():
            return "hold" if pressed else "rest"
        case FindSurface():
            return "find surface"
        case AcquireFrames():
            return "unloaded frames"
        case MarkUnloaded():
            return "mark"
        case _:
            return type(step).__name__.lower()
