"""What is left of a load once it is gone."""

from typing import Any, ClassVar

from cbsr_qa.calibrate.characteristic import data_sheet_loads
from cbsr_qa.calibrate.creep import held_alike, zero_return
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown


class ZeroReturn:
    """``zero_return`` [% of the loaded change]: what is left of the conductance change at the end of the rest.

    ISO 376's zero error, read at the end of the rest instead of after 30 s and taken relative to each press's own
    change. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"zero_return": "%"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("zero-return", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Put the rests of the commonest length together."""
        try:
            loads, rest_s = held_alike(data_sheet_loads(run), _rest_s)
            found = zero_return(loads, frames=run.settings.steady_frames)
        except NumericsError as error:
            return (refused("zero_return", "%", error),)
        presses = counted(len(loads), "press", "presses")
        how = f"last frames of {rest_s:g} s of rest over the last ones of the hold; {presses}"
        return (percent("zero_return", found, how),)


def _rest_s(load: LoadObservation) -> float:
    return load.record.rest_end_s - load.record.unloaded_s
