"""How evenly the sheet responds from place to place."""

from typing import Any, ClassVar

from cbsr_qa.calibrate.characteristic import data_sheet_loads
from cbsr_qa.calibrate.data_sheet import relative_spread
from cbsr_qa.calibrate.uniformity import place_responses, scatter_of_presses
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown

#: With this qualifier the spread is that of ρ̄₀ as it is, imaging included.
AS_IMAGED = "baseline conductance"


class Uniformity:
    """``uniformity`` [%]: standard deviation of the response over the locations, over its mean.

    Without a qualifier the response of a location is its ρ₀ (Eq 7) over what the linearised model of an even sheet
    images there; with ``baseline conductance`` it is ρ₀ itself, which differs from place to place on an even sheet
    too. At the strain at which the most locations were pressed. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"uniformity": "%"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("uniformity", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Spread the locations."""
        try:
            places, strain = place_responses(run, data_sheet_loads(run))
            own = relative_spread([place.response for place in places])
            imaged = relative_spread([place.baseline for place in places])
        except NumericsError as error:
            return (refused("uniformity", "%", error),)
        presses = sum(len(place.responses) for place in places)
        how = f"{len(places)} locations at {100 * strain:g} % strain, {counted(presses, 'press', 'presses')}"
        scatter = scatter_of_presses(places)
        alone = "" if scatter is None else f"; the scatter of presses alone would make {100 * scatter:.1f} %"
        return (
            percent("uniformity", own, f"ρ₀ over what an even sheet images there; {how}{alone}"),
            percent("uniformity", imaged, f"ρ₀ as imaged; {how}", qualifier=AS_IMAGED),
        )
