"""Voltages of a sheet: the cost of accuracy in unknowns, time and memory, by size and order of the elements.

Time is processor time of one core, independent of the machine's other load.
"""

import time
import timeit
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Final, TypeVar

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.elements import FiniteElements
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.loads.pinned_disc import PinnedDisc
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis

T = TypeVar("T")

#: Series by the kind of electrodes.
SERIES_FORWARD: Final[Mapping[str, str]] = {
    "arc": "forward-model, electrodes on the edge",
    "pin": "forward-model, pins",
}

_ARC_HALF_RAD: Final = 0.05  # an arc of 5 mm on a sheet of 50 mm
_ARC_CONTACT_MM: Final = 2.5  # z γ of the arcs; 0.05 radii
_PIN_CONTACT_MM: Final = 0.2
_INCLUSION: Final = (0.5, 3.0)  # radius over the sheet's, and conductance over the sheet's
_HEAD_MM, _CONTRAST = 6.5, 0.5
_ENTRY_BYTES: Final = 12  # a double and its index
_LEAST_S: Final = 2e-3  # shorter bursts are below the clock's resolution on some systems
REPEATS: Final = 7


def time_call(run: Callable[[], T]) -> tuple[T, float]:
    """Run once and return the result and the processor time [s]; with several threads, the sum over them."""
    start_s = time.process_time()
    result = run()
    return result, time.process_time() - start_s


def fastest_s(run: Callable[[], object], repeats: int = REPEATS) -> float:
    """Processor time of one call [s]: the fastest of several bursts of two milliseconds, after one to fill caches."""
    timer, calls = timeit.Timer(run, timer=time.process_time), 1
    while timer.timeit(calls) < _LEAST_S:
        calls *= 2
    return min(timer.repeat(repeats, calls)) / calls


def measure_forward(electrodes: str, order: int, size_mm: float) -> Point:
    """Measure one mesh against exact voltages of the 100 mm disc.

    Errors are ‖V − V_exact‖/‖V_exact‖ over the 208 readings that touch no driven electrode. With electrodes on the
    edge (5 mm arcs) the exact solutions are Fourier series on the electrodes' Legendre polynomials, for a homogeneous
    disc and for one with a concentric inclusion of half the radius and three times the conductance, which no edge of
    the mesh follows. With the shipped disc's pins they are multipoles, for the unloaded disc and for loads of +50 %
    under the 13 mm head at the nine places: there the error is that of the readings' *change*, the mean of nine.

    ``compute_s`` is one new conductance: assembling, factorising and solving all 16 drives. ``memory_bytes`` counts
    factors, matrix, element matrices and potentials of the electrodes.

    Parameters
    ----------
    electrodes : ``"arc"`` or ``"pin"``.
    order : order of the elements.
    size_mm : edge length far from the electrodes.
    """
    sensor, contact_mm = _disc(), _PIN_CONTACT_MM
    if electrodes == "arc":
        sensor, contact_mm = replace(sensor, electrodes=_arcs()), _ARC_CONTACT_MM

    def make_model() -> ForwardModel:
        mesh = sheet_mesh(sensor, size_mm=size_mm, order=order)
        contacts = np.full(sensor.electrodes.count, contact_mm)
        return ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), contacts, order=order)

    model, setup_s = time_call(make_model)
    accuracy = _arc_errors(model) if electrodes == "arc" else _pin_errors(model)
    return Point(
        TimeBasis.COMPUTER,
        SERIES_FORWARD[electrodes],
        {"element_order": order, "element_size_mm": size_mm},
        {name: Accuracy(error, None, "1") for name, error in accuracy.items()},
        fastest_s(lambda: model.with_values().voltages()),
        note=f"{len(model.mesh.elements)} elements",
        costs={
            "setup_s": setup_s,
            "unknowns": float(model.elements.count),
            "memory_bytes": memory_bytes(model.elements, sensor.electrodes.count),
        },
    )


def memory_bytes(elements: FiniteElements, electrodes: int) -> float:
    """Memory of a prepared sheet [bytes]: factors, matrix, element matrices, potentials of its electrodes.

    Factors of contacts, a part in a thousand, are left out.
    """
    cells, stiffness = elements.cells, elements.stiffness
    k = cells.shape[1]
    rows, columns = np.append(np.repeat(cells, k, axis=1), 0), np.append(np.tile(cells, k), 0)
    values = np.append(stiffness, 1.0)  # the last has a fixed node: potentials have a free constant
    matrix = sparse.csc_matrix((values, (rows, columns)), shape=(elements.count,) * 2)
    options = {"SymmetricMode": True, "Equil": False}
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, relax=1, panel_size=1, options=options)
    sparse_bytes = _ENTRY_BYTES * (factors.nnz + matrix.nnz)
    return float(sparse_bytes + stiffness.nbytes + 8 * elements.count * electrodes)


def _arc_errors(model: ForwardModel) -> dict[str, float]:
    radius_share, contrast = _INCLUSION
    covered = cover(model.elements, RoundFootprint(0.0, 0.0, radius_share * _disc().radius_mm))
    included = model.with_change_on(covered.elements, covered.change(model.conductance, contrast - 1))
    return {
        "voltage_error": _error(model, model.readings(_exact_arcs(0.0))),
        "voltage_error_inclusion": _error(included, model.readings(_exact_arcs(radius_share))),
    }


def _pin_errors(model: ForwardModel) -> dict[str, float]:
    local, is_usable = LocalUpdate(model), model.pattern.usable()
    reference, errors = model.voltages(), []
    unloaded, changes = _exact_pins()
    for (x_mm, y_mm), exact in zip(NINE_LOCATIONS_MM, changes, strict=True):
        covered = cover(model.elements, RoundFootprint(x_mm, y_mm, _HEAD_MM))
        pressed = local.voltages(covered.elements, covered.change(model.conductance, _CONTRAST))
        errors.append(np.linalg.norm((pressed - reference)[is_usable] - exact) / np.linalg.norm(exact))
    return {
        "voltage_error": _error(model, model.readings(unloaded)),
        "load_signal_error": float(np.mean(errors)),
    }


def _error(model: ForwardModel, exact: Array) -> float:
    is_usable = model.pattern.usable()
    return float(np.linalg.norm((model.voltages() - exact)[is_usable]) / np.linalg.norm(exact[is_usable]))


@cache
def _disc() -> SensorType:
    return load_sensor_type("disc-100mm").value


def _arcs() -> ElectrodeLayout:
    """Electrodes on the edge of the shipped disc instead of its pins."""
    radius_mm = _disc().radius_mm
    return ElectrodeLayout(16, ElectrodeKind.ARC, radius_mm, 2 * _ARC_HALF_RAD * radius_mm, 0.0, True)


@cache
def _exact_arcs(inclusion: float) -> Array:
    radius_mm, angles = _disc().radius_mm, _arcs().angles_rad()
    sheet = ConcentricSheet(radius_mm, 1.0, inclusion * radius_mm, _INCLUSION[1])
    return arc_transfer_impedance(sheet, angles, _ARC_HALF_RAD, _ARC_CONTACT_MM, modes=30, harmonics=60_000)


@cache
def _exact_pins() -> tuple[Array, Array]:
    """Voltages of the unloaded disc, and changes of the used readings under each of the nine loads alone (9, m)."""
    pinned = PinnedDisc(_disc().radius_mm, _disc().electrodes, _PIN_CONTACT_MM)
    pattern, count = _disc().pattern, len(NINE_LOCATIONS_MM)
    loads = RoundLoads.from_contrast(np.array(NINE_LOCATIONS_MM), np.full(count, _HEAD_MM), np.full(count, _CONTRAST))
    return pinned.transfer_impedance(), RoundLoadModel(pinned, pattern).readings(loads).change[:, pattern.usable()]
