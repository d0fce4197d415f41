"""A strip with two pins: how far the reading between them tells what the material under the head does.

The current between the pins passes their contacts, the strip beside the head and the strip under it, all in series.
Only the last changes under load, so that the reading changes by less than the material does (about a third on the
shipped strip). How much less follows from the forward model of the strip, and from what is assumed of the contacts.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.forward.coverage import cover
from cbsr_qa.forward.local import LocalUpdate
from cbsr_qa.forward.meshing import sheet_mesh
from cbsr_qa.forward.model import ForwardModel

Array = NDArray[np.float64]

_SIZE: Final = 0.1  # edge length far from the pins, of the strip's radius: changes of readings to 5e-4
_CHANGES: Final = np.expm1(np.linspace(-np.log(20.0), np.log(20.0), 41))  # of conductance, that are tabulated


def check_strip(sensor_type: SensorType) -> None:
    """Refuse a sensor type that is no strip.

    Raises
    ------
    NumericsError
        Saying what makes one.
    """
    pattern = sensor_type.pattern
    if sensor_type.electrodes.count != 2 or pattern.drive[0] != pattern.measure[0]:
        raise NumericsError(
            f"sensor type {sensor_type.name!r} is no strip: a material is characterised between two pins that carry"
            " the current and are read themselves",
            remedy="use a sensor type of two electrodes, such as strip-40x20mm",
        )


class StripModel:
    """The resistance of a strip while the conductance under the head changes.

    Parameters
    ----------
    sensor_type : of two electrodes, whose first drive pair is also its first measure pair.
    indenter : the head, with its axis over the place.
    contact_length_mm : contact impedance of a pin over the strip's sheet resistance.
    place_mm : of the head's axis.

    Raises
    ------
    NumericsError
        If the sensor type is no strip, or the head does not touch it.
    """

    def __init__(
        self,
        sensor_type: SensorType,
        indenter: Indenter,
        contact_length_mm: float,
        *,
        place_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        check_strip(sensor_type)
        pattern = sensor_type.pattern
        mesh = sheet_mesh(sensor_type, size_mm=_SIZE * sensor_type.radius_mm, order=2)
        contact = np.full(2, float(contact_length_mm))
        model = ForwardModel(mesh, pattern, np.ones(len(mesh.elements)), contact, order=2)
        covered = cover(model.elements, indenter.at(*place_mm))
        if not covered.elements.size:
            raise NumericsError(f"the head at ({place_mm[0]:g}, {place_mm[1]:g}) mm does not touch the strip")
        update = LocalUpdate(model)
        resistance = [
            update.voltages(covered.elements, covered.change(model.conductance, float(change)))[0, 0]
            for change in _CHANGES
        ]
        #: how much of the head is on the strip
        self.pressed_mm2 = float(covered.share @ mesh.areas_mm2[covered.elements])
        #: resistance between the pins over the sheet resistance, unloaded
        self.squares = float(model.voltages()[0, 0])
        #: of ``squares``, what lies in the contacts
        self.contact_squares = float((model.contact_jacobian()[0, 0] * contact).sum())
        # In logarithms both ways are nearly straight: a spline through these points is right to 1e-6 of a change.
        local, apparent = np.log1p(_CHANGES), np.log(self.squares / np.array(resistance))
        self._apparent, self._local = CubicSpline(local, apparent), CubicSpline(apparent, local)
        self._range = (float(np.expm1(apparent[0])), float(np.expm1(apparent[-1])))

    @property
    def share(self) -> float:
        """Apparent over local change, of small changes: the head's share of the reading."""
        return float(self._apparent(0.0, 1))

    def apparent(self, local: Array) -> Array:
        """Relative change of the conductance between the pins, of relative changes under the head."""
        return np.asarray(np.expm1(self._apparent(np.log1p(local))), dtype=np.float64)

    def local(self, apparent: Array) -> Array:
        """Relative change of the conductance under the head, of relative changes between the pins.

        Raises
        ------
        NumericsError
            If a change is more than the strip under the head can make.
        """
        lowest, highest = self._range
        if apparent.size and not lowest <= float(apparent.min()) <= float(apparent.max()) <= highest:
            raise NumericsError(
                f"the conductance between the pins changes by {apparent.min():.3g} to {apparent.max():.3g} of itself;"
                f" what lies under the head can change it by {lowest:.3g} to {highest:.3g}",
                remedy="look for a loose pin: its contact changes, not the material",
            )
        return np.asarray(np.expm1(self._local(np.log1p(apparent))), dtype=np.float64)
