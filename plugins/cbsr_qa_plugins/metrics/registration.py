"""How the grid of places as a whole is seen shifted, turned and scaled, and what errors are left without that."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.steps import Role
from cbsr_qa.imaging.registration import Registration, register
from cbsr_qa_plugins.metrics._shared import at_load, refuse_unknown

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
        seen = [(load, place) for load in run.loads if load.phase in grids and (place := _seen(load, run))]
        nominal = np.array([(load.record.load.x_mm, load.record.load.y_mm) for load, _ in seen]).reshape(-1, 2)
        try:
            found = register(nominal, np.array([place for _, place in seen]).reshape(-1, 2))
        except NumericsError as error:
            why = f"not registered: {error.reason}"
            return tuple(Measurement(name, None, unit, how=why) for name, unit in _WHOLE.items())
        return (*_whole(found, len(seen)), *_each([load for load, _ in seen], found))


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


def _each(loads: Sequence[LoadObservation], found: Registration) -> tuple[Measurement, ...]:
    how = "centre of mass, less what all places share"
    return tuple(
        at_load(load, "registered_centre_of_mass_error", float(error), "mm", how=how)
        for load, error in zip(loads, found.errors_mm, strict=True)
    )
