"""The simulated sheet: a forward model whose conductance changes under the head."""

from collections.abc import Mapping
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.footprints import overlap_mm2
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.forward.local import LocalUpdate
from cbsr_qa.forward.meshing import sheet_mesh
from cbsr_qa.forward.model import ForwardModel

Array = NDArray[np.float64]
Place = tuple[float, float]

#: Contact impedance of a pin over the sheet's resistance, z γ [mm]. Chosen by us, since the paper gives no contact
#: impedance: about a tenth of the inter-electrode resistance then lies in the contacts of 0.65 mm pins.
CONTACT_LENGTH_MM: Final = 0.2


class SimulatedSheet:
    """A uniform sheet whose mean inter-electrode resistance is the material's.

    The model is solved for a sheet conductance of 1 S and a contact impedance of ``contact_length_mm`` Ω·mm: all
    voltages of a sheet of conductance γ₀ whose contacts scale with it are 1/γ₀ of these, exactly.

    Parameters
    ----------
    sensor_type : geometry and electrodes.
    size_mm : element size far from the electrodes; keep it different from the image's.
    interelectrode_resistance_ohm : mean over all pairs of neighbouring electrodes, contacts included.
    contact_length_mm : contact impedance over sheet resistance.
    """

    def __init__(
        self,
        sensor_type: SensorType,
        *,
        size_mm: float,
        interelectrode_resistance_ohm: float,
        contact_length_mm: float = CONTACT_LENGTH_MM,
    ) -> None:
        self.sensor_type = sensor_type
        self.mesh = sheet_mesh(sensor_type, size_mm=size_mm)
        count = sensor_type.electrodes.count
        contacts = np.full(count, contact_length_mm)
        self.unit_model = ForwardModel(self.mesh, sensor_type.pattern, np.ones(len(self.mesh.elements)), contacts)
        self._update = LocalUpdate(self.unit_model)
        self._covers: dict[tuple[Place, Indenter], tuple[NDArray[np.int64], Array]] = {}
        #: sheet conductance γ₀ [S]
        self.conductance_S = _neighbour_resistance(self.unit_model) / interelectrode_resistance_ohm
        #: readings of the unloaded sheet, (drives, measures) [V/A]
        self.unloaded: Array = self.unit_model.voltages() / self.conductance_S

    def voltages(self, changes: Mapping[Place, float], indenter: Indenter) -> Array:
        """Readings per ampere while places under a head have changed.

        Parameters
        ----------
        changes : relative conductance change by place; an element partly covered changes by its covered share, and
            changes of places that overlap add.
        indenter : the head.

        Returns
        -------
        (drives, measures) float64 [V/A].

        Raises
        ------
        RefusedError
            If a head lies wholly outside the sheet.
        NumericsError
            If a change would leave an element without conductance.
        """
        if not changes:
            return self.unloaded.copy()
        elements, relative = self.relative_change(changes, indenter)
        return self._update.voltages(elements, relative) / self.conductance_S

    def relative_change(self, changes: Mapping[Place, float], indenter: Indenter) -> tuple[NDArray[np.int64], Array]:
        """Return which elements change and by how much: (k,) int64 and (k,) relative; repeated elements add up."""
        covers = [self._cover(place, indenter) for place in changes]
        elements = np.concatenate([cover[0] for cover in covers])
        shares = [share * change for (_, share), change in zip(covers, changes.values(), strict=True)]
        return elements, np.concatenate(shares)

    @cached_property
    def contact_share(self) -> float:
        """Share of the inter-electrode resistance that lies in the contacts.

        A resistance is homogeneous of degree one in (1/γ, z), so the sheet's part is −Σ γ ∂R/∂γ (Euler).
        """
        pattern = self.sensor_type.pattern
        slope = self.unit_model.jacobian().sum(axis=2)
        driven = np.array([[pair == other for other in pattern.measure] for pair in pattern.drive])
        return 1 + float(slope[driven].sum() / self.unit_model.voltages()[driven].sum())

    def _cover(self, place: Place, indenter: Indenter) -> tuple[NDArray[np.int64], Array]:
        """Elements under the head at a place, and the covered share of each."""
        known = self._covers.get((place, indenter))
        if known is not None:
            return known
        share = overlap_mm2(indenter.at(*place), self.mesh.corners_mm) / self.mesh.areas_mm2
        elements = np.flatnonzero(share > 0)
        if not elements.size:
            raise RefusedError(
                f"a head of radius {indenter.reach_mm:g} mm at ({place[0]:g}, {place[1]:g}) mm is outside the sheet",
                remedy=f"the sheet {self.sensor_type.outline.words()}",
            )
        cover = (elements, np.minimum(share[elements], 1.0))
        self._covers[(place, indenter)] = cover
        return cover


def _neighbour_resistance(model: ForwardModel) -> float:
    """Mean resistance between neighbouring electrodes [Ω]."""
    impedance = model.transfer_impedance
    following = np.roll(np.arange(len(impedance)), -1)
    own = np.diag(impedance)
    return float(np.mean(own + own[following] - 2 * impedance[np.arange(len(own)), following]))
