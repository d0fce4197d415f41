"""Sequences: what makes a recipe's steps."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.domain.steps import Step


@dataclass(frozen=True, slots=True)
class SequenceContext:
    """What a sequence may know when it makes its steps.

    Parameters
    ----------
    sensor_type, indenter : what is tested.
    seed : of the run; a sequence that draws numbers addresses them by its own name.
    """

    sensor_type: SensorType
    indenter: Indenter
    seed: int


class Sequence(Protocol):
    """Makes steps. It never touches an instrument: the runner does, and a dry run only counts.

    A sequence may have an attribute ``role`` (:class:`~cbsr_qa.domain.steps.Role`) that says what it is for;
    metrics and report sections look for roles. Without it the role is OTHER.
    """

    def steps(self, context: SequenceContext) -> Iterator[Step]:
        """Yield the steps, the same ones each time it is asked."""
        ...
