"""What the last cycle of preconditioning still changed."""

from collections.abc import Mapping
from typing import Any, ClassVar

from cbsr_qa.calibrate.creep import change_between, last_cycles, last_stresses
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa.domain.steps import Role
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown

_NAME = "preconditioning_change"


class PreconditioningChange:
    """``preconditioning_change`` [%]: change between the last two cycles, over the last; ``preconditioning_cycles``.

    Of the conductance change at the end of the hold, counted from just before the press, and with the qualifier
    ``stress`` of the stress: of all locations together and of each. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {_NAME: "%", "preconditioning_cycles": "1"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("preconditioning-change", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Compare the last two cycles of every location."""
        phases = {phase.name for phase in run.record.phases if phase.role is Role.PRECONDITIONING}
        loads = [load for load in run.loads if load.phase in phases]
        if not loads:
            none = NumericsError(
                "the recipe has no preconditioning", remedy="begin it with the sequence preconditioning"
            )
            return (refused(_NAME, "%", none),)
        cycles = 1 + max(load.record.load.trial for load in loads)
        strain = max(load.record.load.strain for load in loads)
        frames = run.settings.steady_frames
        how = f"cycle {cycles - 1} to cycle {cycles} at {100 * strain:g} % strain"
        count = Measurement("preconditioning_cycles", float(cycles), "1", how="cycles of each location, as planned")
        return (
            count,
            *_of(last_cycles(loads, frames=frames), "", how),
            *_of(last_stresses(loads), "stress", how),
        )


def _of(levels: Mapping[str, tuple[float, float]], qualifier: str, how: str) -> tuple[Measurement, ...]:
    try:
        change = change_between(levels.values())
    except NumericsError as error:
        return (refused(_NAME, "%", error, qualifier=qualifier),)
    each = [
        Measurement(_NAME, 100 * (after - before) / after, "%", location=place, qualifier=qualifier, how=how)
        for place, (before, after) in levels.items()
        if after > 0
    ]
    return (percent(_NAME, change, f"{how}; {counted(len(levels), 'location')}", qualifier=qualifier), *each)
