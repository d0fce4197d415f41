"""The load model of a sensor type, made once per process."""

from functools import lru_cache
from typing import Final

import numpy as np

from cbsr_qa.domain.electrodes import ElectrodeKind
from cbsr_qa.domain.outlines import Disc
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.forward.meshed_sheet import MeshedSheet
from cbsr_qa.forward.meshing import sheet_mesh
from cbsr_qa.forward.model import ForwardModel
from cbsr_qa.forward.pinned_disc import PinnedDisc
from cbsr_qa.forward.round_load import RoundLoadModel
from cbsr_qa.reconstruct.problem import NOMINAL_CONTACT_MM

_MESH_SIZE: Final = 0.12  # edge length, of the radius: fields are read from the edge, where meshes are finer


@lru_cache(maxsize=8)
def load_model(sensor_type: SensorType) -> RoundLoadModel:
    """Readings of the even sheet under a round load, at unit sheet conductance.

    A disc with pins has its fields exactly; any other sheet, or one with a mesh of its own, by finite elements.
    """
    round_sheet = isinstance(sensor_type.outline, Disc) and sensor_type.mesh is None
    if round_sheet and sensor_type.electrodes.kind is ElectrodeKind.PIN:
        sheet = PinnedDisc(sensor_type.radius_mm, sensor_type.electrodes, NOMINAL_CONTACT_MM)
        return RoundLoadModel(sheet, sensor_type.pattern)
    mesh = sheet_mesh(sensor_type, size_mm=_MESH_SIZE * sensor_type.radius_mm, order=2)
    contacts = np.full(sensor_type.electrodes.count, NOMINAL_CONTACT_MM)
    model = ForwardModel(mesh, sensor_type.pattern, np.ones(len(mesh.elements)), contacts, order=2)
    return RoundLoadModel(MeshedSheet(model, sensor_type.radius_mm), sensor_type.pattern)
