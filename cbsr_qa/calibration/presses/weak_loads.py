"""Changes of a modelled sheet's readings under weak loads, for electrode pairs of any kind and order."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.loads.round_load import RoundLoadModel

#: Radius of the modelled load, of the sheet's: the registration hardly depends on it.
_LOAD: Final = 0.08
#: Least distance of places from edge and electrodes, of the radius.
_CLEAR: Final = 0.02
#: Largest radius of a modelled load, over its distance from edge and electrodes.
_SMALL: Final = 0.5
#: Spacing of the lattice of places, of the sheet's radius.
STEP: Final = 0.08
_AT_ONCE: Final = 256


@dataclass(frozen=True, slots=True, eq=False)
class WeakLoads:
    """Changes of transfer impedances under weak loads, per strength.

    Parameters
    ----------
    places : (k, 2) places of the loads, in radii of the sheet.
    changes : (k, e, e) changes of the potential of one electrode by the current into another; electrode e − 1 is the
        earth.
    """

    places: Array
    changes: Array

    @property
    def node(self) -> Indices:
        """Columns and rows (k, 2) of places on the lattice."""
        return np.round(self.places / STEP).astype(np.int64)

    def readings(self, pairs: Indices) -> Array:
        """Changes (k, m) of readings of pairs (m, 4): source, sink, plus, minus."""
        return _readings(self.changes, pairs)


class ModelledSheet:
    """A sensor type's even sheet, in radii.

    Parameters
    ----------
    sensor_type : sensor type; its pattern does not matter.
    """

    def __init__(self, sensor_type: SensorType) -> None:
        self.radius_mm = sensor_type.radius_mm
        self.electrode_count = count = sensor_type.electrodes.count
        to_earth = tuple((electrode, count - 1) for electrode in range(count - 1))
        pattern = DrivePattern(count, to_earth, to_earth)
        self._model = RoundLoadModel(load_model(sensor_type).surroundings, pattern)

    def solve_unloaded(self, pairs: Indices) -> Array:
        """Readings (m,) of pairs (m, 4) without a load, per current."""
        readings: Array = _readings(_with_earth(self._model.solve_unloaded()[None]), pairs)[0]
        return readings

    def loads(self, places: Array) -> WeakLoads:
        """Weak loads at places (k, 2) in radii, each clear of edge and electrodes."""
        places_mm = places * self.radius_mm
        clearance_mm = self._model.surroundings.clearance_mm(places_mm)
        size = np.minimum(_LOAD * self.radius_mm, _SMALL * np.maximum(clearance_mm, _CLEAR * self.radius_mm))
        order = np.argsort(-clearance_mm, kind="stable")  # places of similar clearance need similar numbers of terms
        changes = np.empty((len(places), *self._model.pattern.shape))
        for first in range(0, len(order), _AT_ONCE):
            batch = order[first : first + _AT_ONCE]
            changes[batch] = self._model.weak(places_mm[batch], size[batch])
        return WeakLoads(places, _with_earth(changes))

    @cached_property
    def lattice(self) -> WeakLoads:
        """Weak loads all over the sheet, on a square lattice about its centre."""
        half_count = int(np.floor(max(map(abs, self._model.surroundings.extent_mm)) / (STEP * self.radius_mm)))
        axis = STEP * np.arange(-half_count, half_count + 1)
        places = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
        return self.loads(places[self.clear(places)])

    def clear(self, places: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Mask (k,) of places (k, 2) in radii that are clear of edge and electrodes."""
        room = self._model.surroundings.clearance_mm(places * self.radius_mm)
        return room > _CLEAR * self.radius_mm


def _with_earth(changes: Array) -> Array:
    """Append the electrode used as reference for all others."""
    return np.pad(changes, ((0, 0), (0, 1), (0, 1)))


def _readings(impedance: Array, pairs: Indices) -> Array:
    source, sink, plus, minus = pairs.T
    driven: Array = impedance[:, source, plus] - impedance[:, source, minus]
    return driven - impedance[:, sink, plus] + impedance[:, sink, minus]
