"""How the sensed signal goes on changing under a head that stands still."""

from typing import Any, ClassVar

from cbsr_qa.calibrate.characteristic import data_sheet_loads
from cbsr_qa.calibrate.creep import FROM_S, SIGNAL, STRESS, creep, creep_at_constant_stress, held_alike
from cbsr_qa.calibrate.data_sheet import Estimate
from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa_plugins.metrics._run_figure import counted, percent, refused
from cbsr_qa_plugins.metrics._shared import refuse_unknown

_KINDS = ("", SIGNAL, STRESS)


class Creep:
    """``creep`` [% of the end value]: change of the signal from a stated time after the ramp to the end of the hold.

    ISA-51.1's change of output at constant input over a stated time. The head holds the strain, so the stress relaxes
    meanwhile: without a qualifier that has been taken out. The qualifiers ``conductance`` and ``stress`` are the
    creep of each as it was seen.

    Parameters
    ----------
    from_s : the stated time; default 5.
    """

    measures: ClassVar[dict[str, str]] = {"creep": "%"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("creep", options, ("from_s",))
        value = options.get("from_s", FROM_S)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 3600:
            raise ConfigError(f"metric 'creep': from_s is {value!r}", remedy="allowed: a number from 0 to 3600")
        self._from_s = float(value)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Put the holds of the commonest length together."""
        try:
            loads, hold_s = held_alike(data_sheet_loads(run), _hold_s)
        except NumericsError as error:
            return (refused("creep", "%", error),)
        how = f"from {self._from_s:g} s after the ramp to the end of {hold_s:g} s; {counted(len(loads), 'hold')}"
        return tuple(self._one(kind, loads, run.settings.steady_frames, how) for kind in _KINDS)

    def _one(self, kind: str, loads: tuple[LoadObservation, ...], frames: int, how: str) -> Measurement:
        try:
            found = self._estimate(kind, loads, frames)
        except NumericsError as error:
            return refused("creep", "%", error, qualifier=kind)
        words = how if kind else f"conductance, the stress's own change taken out, {how}"
        return percent("creep", found, words, qualifier=kind)

    def _estimate(self, kind: str, loads: tuple[LoadObservation, ...], frames: int) -> Estimate:
        if kind:
            return creep(loads, kind, from_s=self._from_s, frames=frames)
        return creep_at_constant_stress(loads, from_s=self._from_s, frames=frames)


def _hold_s(load: LoadObservation) -> float:
    return load.record.release_start_s - load.record.hold_start_s
