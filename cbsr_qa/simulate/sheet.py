"""The simulated sheet: a forward model whose conductance changes under the head."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.sensor.electrodes import PlacedElectrodes
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.coverage import Cover, NestedCover, cover, cover_by_nested_outlines
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.family import LoadFamily
from cbsr_qa.eit.loads.sheet import LoadedSheet
from cbsr_qa.eit.mesh.sheet import sheet_mesh

Place = tuple[float, float]

_ORDER: Final = 2  # of the elements; the image's Jacobian is another mesh's
_PLACES: Final = 512  # number of cached covers


#: Finest mesh, of the sheet's radius, which takes a minute; half of it exceeds the mesher's points.
_FINEST: Final = 0.02


def finest_mesh_mm(sensor_type: SensorType) -> float:
    """Smallest element size a scene may use; 0 if the sensor type has its own mesh."""
    return _FINEST * sensor_type.radius_mm if sensor_type.mesh is None else 0.0


class SimulatedSheet:
    """A sheet scaled to the material's mean inter-electrode resistance.

    The model is solved for a mean sheet conductance of 1 S and contact impedances in mm: all voltages of a sheet of
    mean conductance γ₀ whose contacts scale with it are exactly 1/γ₀ of these. RefusedError if electrodes were moved
    off the sheet, or onto each other. ``size_mm``: element size far from the electrodes; keep it different from the
    image's.
    """

    def __init__(self, design: SheetDesign, *, size_mm: float, interelectrode_resistance_ohm: float) -> None:
        self.design = design
        self.sensor_type = _move_sheet(design.sensor_type, design.shift_mm)
        self.mesh = sheet_mesh(self.sensor_type, size_mm=size_mm, order=_ORDER)
        conductance = design.sheet_conductance_at(self.mesh.centroids_mm)
        self.unit_model = ForwardModel(
            self.mesh, self.sensor_type.pattern, conductance, design.contact_mm, order=_ORDER
        )
        self._loaded = LoadedSheet(self.unit_model)
        self._loads: OrderedDict[Place, LoadFamily] = OrderedDict()
        self._pressed_mm2: dict[Place, float] = {}
        #: mean sheet conductance γ₀ [S]
        self.conductance_S = _neighbour_resistance(self.unit_model) / interelectrode_resistance_ohm
        #: readings of the unloaded sheet, (drives, measures) [V/A]
        self.unloaded: Array = self.readings(self.impedance({}))

    def voltages(self, changes: Mapping[Place, float]) -> Array:
        """Readings per ampere for local changes under heads: (drives, measures) [V/A].

        Parameters and errors as for :meth:`impedance`.
        """
        return self.readings(self.impedance(changes))

    def impedance(self, changes: Mapping[Place, float], contact_mm: Array | None = None) -> Array:
        """Electrode potentials per electrode current for local changes under heads.

        Returns (electrodes, electrodes) float64 [V/A], for currents that sum to zero and differences of potentials.
        RefusedError if a head lies wholly outside the sheet; NumericsError if a change would leave an element without
        conductance. Several changed places are accurate to 1e-8 of the mean reading, single ones to rounding.

        Parameters
        ----------
        changes : relative conductance change by place, under a head that presses evenly; changes of places that
            overlap add.
        contact_mm : (electrodes,) contact impedance over the mean sheet resistance; by default the design's.
        """
        impedance: Array = self.impedances([changes], contact_mm)[0]
        return impedance

    def impedances(self, changes: Sequence[Mapping[Place, float]], contact_mm: Array | None = None) -> Array:
        """The same at moments within a frame, up to third-order terms in the change since the first.

        Parameters and errors as for :meth:`impedance`; unchanged places may be left out. Returns (moments,
        electrodes, electrodes) float64 [V/A].
        """
        places = {place: self.load_at(place) for moment in changes for place in moment}
        loads = [{load: moment.get(place, 0.0) for place, load in places.items()} for moment in changes]
        return self._loaded.transfer_impedances(loads, contact_mm) / self.conductance_S

    def readings(self, impedance_ohm: Array) -> Array:
        """Readings per ampere of a transfer impedance: (drives, measures) [V/A]."""
        return self.unit_model.readings(impedance_ohm)

    def area_under_head_mm2(self, place: Place) -> float:
        """Share of a head that is on the sheet, at a place."""
        if place not in self._pressed_mm2:
            if len(self._pressed_mm2) >= _PLACES:
                self._pressed_mm2.clear()
            self._pressed_mm2[place] = self._overlap_mm2(place)
        return self._pressed_mm2[place]

    def _overlap_mm2(self, place: Place) -> float:
        head, outline = self.design.indenter, self.sensor_type.outline
        if outline.clearance_mm(np.array([place]))[0] >= head.reach_mm:
            return head.area_mm2
        covered = cover(self.unit_model.elements, head.footprint_at(*place))
        return float(covered.share @ self.mesh.areas_mm2[covered.elements])

    @cached_property
    def contact_share(self) -> float:
        """Share of the contacts in the resistance of driven pairs.

        A resistance is homogeneous of degree one in (1/γ, z), so the contacts' part is Σ z ∂R/∂z (Euler).
        """
        pattern = self.sensor_type.pattern
        part = self.unit_model.contact_jacobian() @ self.unit_model.contact_impedance
        driven = np.array([[pair == other for other in pattern.measure] for pair in pattern.drive])
        return float(part[driven].sum() / self.unit_model.voltages()[driven].sum())

    def load_at(self, place: Place) -> LoadFamily:
        """Response of the sheet to a head at a place, for any relative change under it.

        RefusedError if the head lies wholly outside the sheet.
        """
        if place not in self._loads:
            while len(self._loads) >= _PLACES:
                self._loads.popitem(last=False)
            self._loads[place] = self._make_loads(place)
        self._loads.move_to_end(place)
        return self._loads[place]

    def _make_loads(self, place: Place) -> LoadFamily:
        head, elements, conductance = self.design.indenter, self.unit_model.elements, self.unit_model.conductance
        rings = sorted(self.design.rings, key=lambda ring: -ring.size)
        largest = head.scale(rings[0].size).footprint_at(*place)
        covered: Cover | NestedCover
        if len(rings) == 1:
            covered = cover(elements, largest)
            weight = rings[0].weight
        else:
            sizes, weights = np.array([(ring.size / rings[0].size, ring.weight) for ring in rings]).T
            covered, weight = cover_by_nested_outlines(elements, largest, place, sizes, weights), 1.0
        if not covered.elements.size:
            raise RefusedError(
                f"a head of radius {head.reach_mm:g} mm at ({place[0]:zg}, {place[1]:zg}) mm is outside the sheet",
                remedy=f"the sheet {self.sensor_type.outline.words()}",
            )
        response = weight * self.design.response_at(self.mesh.centroids_mm[covered.elements])
        return LoadFamily(covered.elements, lambda relative: covered.change(conductance, relative * response))


def _move_sheet(sensor_type: SensorType, shift_mm: Array) -> SensorType:
    if not shift_mm.any():
        return sensor_type
    layout = sensor_type.electrodes
    places = tuple((float(x), float(y)) for x, y in layout.positions_mm() + shift_mm)
    return replace(sensor_type, electrodes=PlacedElectrodes(layout.kind, places, layout.width_mm))


def _neighbour_resistance(model: ForwardModel) -> float:
    """Mean resistance between neighbouring electrodes [Ω]."""
    impedance = model.transfer_impedance
    following = np.roll(np.arange(len(impedance)), -1)
    diagonal = np.diag(impedance)
    return float(np.mean(diagonal + diagonal[following] - 2 * impedance[np.arange(len(diagonal)), following]))
