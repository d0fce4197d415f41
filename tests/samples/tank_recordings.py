"""A tank with balls in it, recorded as EIDORS's phantom is: magnitudes, nothing at driven electrodes."""

import numpy as np
import scipy.io

from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.mesh.sheet import sheet_mesh

#: On a flat sheet, as far out as a flat model puts those of the real recording, which are 70 mm from the middle.
BALLS_MM = ((95.0, 0.0), (0.0, 95.0))


def write_phantom(path, count=16):
    """Write ``vvRef`` of the empty tank and ``vvAvg3`` with two insulating balls, (count², 1) each."""
    ring = ElectrodeLayout(count, ElectrodeKind.ARC, 150.0, 10.0, 0.0, True)
    tank = SensorType("pail", 150.0, 260.0, ring, adjacent_pattern(count), Response.AUTO)
    mesh = sheet_mesh(tank, size_mm=15.0, order=2)
    empty = ForwardModel(mesh, tank.pattern, np.ones(len(mesh.elements)), np.full(count, 1.0), order=2)
    parts = [cover(empty.elements, RoundFootprint(x_mm, y_mm, 20.0)) for x_mm, y_mm in BALLS_MM]
    elements = np.concatenate([part.elements for part in parts])
    change = np.concatenate([part.change(empty.conductance, -0.9) for part in parts])
    used = tank.pattern.usable()
    frames = (empty.voltages(), empty.with_change_on(elements, change).voltages())
    names = ("vvRef", "vvAvg3")
    scipy.io.savemat(
        path, {name: np.abs(np.where(used, one, 0.0)).reshape(-1, 1) for name, one in zip(names, frames, strict=True)}
    )
