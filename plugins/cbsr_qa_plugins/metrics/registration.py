"""How the grid of places as a whole is seen shifted, turned and scaled, and what errors are left without that."""

from typing import Any, ClassVar

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.steps import Role
from cbsr_qa.imaging.registration import Registration, register
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown

_HOW = "centre of mass, less what all places share"
_WHOLE = {"registration_shift": "mm", "registration_rotation": "°", "registration_scale": "1"}


class RegistrationOfPlaces:
    """``registration_shift`` [mm], ``registration_rotation`` [°] and ``registration_scale`` of the places of a grid.

    A disc that is seated askew, or a station whose axes are off, moves all places alike; what is left of each load's
    centre-of-mass error without that is ``registered_centre_of_mass_error`` [mm]. The first three belong to the
    station, the last to the sensor. Of the loads of all phases that press a grid, under the main mask. It has no
    options.
    """

    measures: ClassVar[dict[str, str]] = {**_WHOLE, "registered_centre_of_mass_error": "mm"}

    def __init__(self, **options: Any) -> None:
        refuse_unknown("registration", options)

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Register the loads that were seen."""
        grids = {phase.name for phase in run.record.phases if phase.role is Role.GRID}
        loads = [load for load in run.loads if load.phase in grids]
        seen = [(load, place) for load in loads if (place := _seen(load, run))]
        nominal = np.array([(load.record.load.x_mm, load.record.load.y_mm) for load, _ in seen]).reshape(-1, 2)
        try:
            found = register(nominal, np.array([place for _, place in seen]).reshape(-1, 2))
        except NumericsError as error:
            why = f"not registered: {error.reason}"
            names = _WHOLE if loads else self.measures  # what nothing is left of is still a number that is lacking
            none = tuple(Measurement(name, None, unit, how=why) for name, unit in names.items())
            return (*none, *(_left(load, None, why) for load in loads))
        errors = {id(load): float(error) for (load, _), error in zip(seen, found.errors_mm, strict=True)}
        each = (_left(load, errors.get(id(load)), _HOW if id(load) in errors else "not detected") for load in loads)
        return (*_whole(found, len(seen)), *each)


def _seen(load: LoadObservation, run: RunObservation) -> tuple[float, float] | None:
    view = load.mask(run.main_mask)
    if view is None or view.region is None:
        return None
    x_mm, y_mm = view.region.centre_mm()
    return float(x_mm), float(y_mm)


def _whole(found: Registration, count: int) -> tuple[Measurement, ...]:
    x_mm, y_mm = found.shift_mm
    how = f"of {count} presses; the origin is seen at ({x_mm:.2f}, {y_mm:.2f}) mm"
    values = (
        (float(np.hypot(x_mm, y_mm)), found.shift_stderr_mm),
        (found.rotation_deg, found.rotation_stderr_deg),
        (found.scale, found.scale_stderr),
    )
    return tuple(
        Measurement(name, value, unit, uncertainty=stderr, how=how)
        for (name, unit), (value, stderr) in zip(_WHOLE.items(), values, strict=True)
    )


def _left(load: LoadObservation, error_mm: float | None, how: str) -> Measurement:
    return at_load(load, "registered_centre_of_mass_error", error_mm, "mm", how=how)
