"""How closely presses of the same place and strain agree."""

from typing import Any, ClassVar

from cbsr_qa.calibrate.characteristic import data_sheet_loads, repeatability, repeated_changes
from cbsr_qa.calibrate.data_sheet import Estimate, pooled_deviation
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class Repeatability:
    """``repeatability`` [% of span]: standard deviation of the sensed change within phase, place and strain, pooled.

    ISO 5725-2's repeatability standard deviation in the unit ISA-51.1 and IEC 61298-2 give repeatability in. Over all
    strains, and by strain where there are several. The span is each place's mean sensed change at the highest strain.
    It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"repeatability": "%"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("repeatability", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Pool the scatter of the trials."""
        loads = data_sheet_loads(run)
        try:
            overall = repeatability(loads, run.main_mask)
        except NumericsError as error:
            return (refused("repeatability", "%", error),)
        highest = max(load.record.load.strain for load in loads)
        cells = repeated_changes(loads, run.main_mask)
        found = [_one(overall, highest, sum(map(len, cells.values())))]
        if len(cells) > 1:
            for strain, members in cells.items():
                qualifier = f"{100 * strain:g} % strain"
                found.append(_one(pooled_deviation(members), highest, len(members), qualifier))
        return tuple(found)


def _one(scatter: Estimate, highest: float, cells: int, qualifier: str = "") -> Measurement:
    again = counted(cells, "place and strain", "places and strains")
    how = (
        f"of the place's span, its mean change at {100 * highest:g} % strain; {again} pressed again,"
        f" {counted(scatter.degrees, 'degree')} of freedom"
    )
    return percent("repeatability", scatter, how, qualifier=qualifier)
