"""The load model of a sensor type, made once per process."""

from functools import lru_cache

from cbsr_qa.domain.electrodes import ElectrodeKind
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.outlines import Disc
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.forward.pinned_disc import PinnedDisc
from cbsr_qa.forward.round_load import RoundLoadModel
from cbsr_qa.reconstruct.problem import NOMINAL_CONTACT_MM


@lru_cache(maxsize=8)
def load_model(sensor_type: SensorType) -> RoundLoadModel:
    """Readings of the homogeneous sheet under a round load, at unit sheet conductance."""
    if not isinstance(sensor_type.outline, Disc) or sensor_type.electrodes.kind is not ElectrodeKind.PIN:
        raise NumericsError(f"loads on sensor type {sensor_type.name!r} have no model yet")
    sheet = PinnedDisc(sensor_type.radius_mm, sensor_type.electrodes, NOMINAL_CONTACT_MM)
    return RoundLoadModel(sheet, sensor_type.pattern)
