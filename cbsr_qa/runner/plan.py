"""What a run is going to do, put together from station and recipe."""

from collections.abc import Iterator
from dataclasses import dataclass

from cbsr_qa.domain.contained import contained
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.plan import Motion, SafetyLimits
from cbsr_qa.domain.sensor import Material, SensorType
from cbsr_qa.domain.steps import Step
from cbsr_qa.interfaces import Sequence, SequenceContext


@dataclass(frozen=True, slots=True)
class PlannedPhase:
    """One phase with the sequence that makes its steps.

    Parameters
    ----------
    name : the recipe's name for it.
    sequence_name : the plugin's.
    """

    name: str
    sequence_name: str
    sequence: Sequence

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the sequence's steps; PluginError where its code fails."""
        with contained(f"sequence {self.sequence_name!r} of phase {self.name!r}"):
            yield from self.sequence.steps(context)


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything the runner and the dry run need to know; nothing in it can move.

    Parameters
    ----------
    phases : in order.
    sensor_type, material, indenter : what is tested, and with which head.
    motion, safety : how the station moves, and what it allows whatever the recipe asks for.
    seed : of the run; sequences that draw numbers address them by their own name.
    """

    phases: tuple[PlannedPhase, ...]
    sensor_type: SensorType
    material: Material
    indenter: Indenter
    motion: Motion
    safety: SafetyLimits
    seed: int

    @property
    def context(self) -> SequenceContext:
        """What the sequences may know."""
        return SequenceContext(self.sensor_type, self.indenter, self.seed)
