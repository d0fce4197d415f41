"""A calibration to entries of its file, and back. An entry that a later version added may be missing."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import INDEX, PRESS_FORMAT, PURE, TEXT, Entry, Reading, format_of
from cbsr_qa.calibration.file.counts import check_counts
from cbsr_qa.calibration.file.fields import Codec, Entries, Irregular, problems
from cbsr_qa.domain.errors import CalibrationError, RefusedError
from cbsr_qa.domain.results.calibration import Calibration, ForceModel, LoadRelaxation
from cbsr_qa.domain.results.learned_place import LearnedPlace
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity
from cbsr_qa.domain.results.press_calibration import PressCalibration
from cbsr_qa.domain.sensor.electrodes import ElectrodeLayout, Electrodes, PlacedElectrodes
from cbsr_qa.domain.sensor.mesh import (
    INTEGERS as MESH_INTEGERS,
    NAMES as MESH_ARRAYS,
    Mesh,
    mesh_arrays,
    mesh_of_arrays,
)
from cbsr_qa.domain.sensor.sensor_type import GivenMesh

#: Templates have unit length, apart from rounding.
_LENGTH_TOLERANCE: Final = 1e-3

_WHY_NOT: Final = "force/none"

#: Possible content of a file.
Issued = Calibration | PressCalibration


def encode(calibration: Issued) -> Mapping[str, Entry]:
    """Return the content of a calibration as entries by path.

    CalibrationError if its matrix was prepared for another sensor type than it names, or it holds more of something
    than is read.
    """
    entries: Entries = {}
    if isinstance(calibration, PressCalibration):
        _CODEC.write(entries, calibration, "")
        check_counts(entries)
        return entries
    prepared_for = calibration.reconstruction.problem.sensor_type
    if prepared_for != calibration.sensor_type:
        raise CalibrationError(
            f"the reconstruction was prepared for sensor type {prepared_for.name!r},"
            f" the calibration is for {calibration.sensor_type.name!r}"
        )
    _CODEC.write(entries, calibration, "")
    entries[_WHY_NOT] = Entry(TEXT, calibration.no_force)
    check_counts(entries)
    return entries


def decode(entries: Mapping[str, Entry]) -> Issued:
    """Return the calibration that some entries describe.

    CalibrationError if an entry is missing, of another type or length, too long, or not allowed.
    """
    check_counts(entries)
    try:
        return (_press_calibration if format_of(entries) == PRESS_FORMAT else _calibration)(entries)
    except CalibrationError:
        raise
    except (RefusedError, ValueError, IndexError, TypeError, ArithmeticError) as error:
        raise CalibrationError(f"the content contradicts itself: {error}") from error


def _press_calibration(entries: Mapping[str, Entry]) -> PressCalibration:
    calibration: PressCalibration = _CODEC.read(Reading(entries), PressCalibration, "")
    for problem in problems(calibration, ""):
        raise CalibrationError(problem)
    count, pairs, readings = calibration.electrodes, calibration.pairs, len(calibration.pairs)
    if not readings or pairs.min() < 0 or pairs.max() >= count:
        raise CalibrationError(f"readings/pairs is empty, or names an electrode other than 0 to {count - 1}")
    for problem in _frame_problems(calibration):
        raise CalibrationError(problem)
    if not (calibration.registration.scale > 0 and calibration.registration.radius_mm > 0):
        raise CalibrationError("registration/scale or registration/radius is not positive")
    for problem in _place_problems(calibration.place, readings, "readings/pairs"):
        raise CalibrationError(problem)
    modelled = calibration.modelled
    if modelled is not None and (not len(modelled.node) or modelled.templates.shape[1] != readings):
        raise CalibrationError(
            f"modelled/templates is empty, or of {modelled.templates.shape[1]} readings, readings/pairs of {readings}"
        )
    for name in ("force", "depth"):
        quantity = getattr(calibration, name)
        if quantity is not None and (why := _quantity_problem(quantity)):
            raise CalibrationError(f"{name}/{why}")
    return calibration


def _frame_problems(calibration: PressCalibration) -> Iterator[str]:
    """Describe errors in the order of a frame's readings, and in what is stated of each."""
    if not (calibration.drive and calibration.measure):
        yield "readings/drive or readings/measure is empty"
    readings = len(calibration.pairs)
    for name in ("rest", "noise"):
        values = getattr(calibration, name)
        if values is not None and values.shape != (readings,):
            yield f"readings/{name} of {values.shape} does not fit {readings} readings"


def _place_problems(place: LearnedPlace, readings: int, stated: str) -> Iterator[str]:
    """Say what makes places impossible to compute from so many readings, of the entry ``stated``."""
    permuted = place.turns.permuted
    of_readings = {
        "scaling/ceiling": place.scaling.ceiling.shape[0],
        "turns/permuted": permuted.shape[1],
        "process/features": place.process.features.shape[1],
        "process/scales/own": place.process.scales.own.shape[0],
        "templates/whitening": place.templates.whitening.shape[0],
    }
    yield from (
        f"place/{name} is of {count} readings, {stated} of {readings}"
        for name, count in of_readings.items()
        if count != readings
    )
    if not permuted.size or permuted.min() < 0 or permuted.max() >= readings:
        yield f"place/turns/permuted names a reading other than 0 to {readings - 1}"
    if not len(place.templates.grid_mm) or not len(place.process.features):
        yield "place/templates/grid or place/process/features is empty"
    low, high = place.mixture.quantiles.tolist()
    if not 0 < low <= high:
        yield "place/mixture/quantiles are not positive and rising"


def _quantity_problem(quantity: LearnedQuantity) -> str:
    """Return the reason why force and depth cannot be computed; empty if they can."""
    values, (low, high) = quantity.values, quantity.quantiles.tolist()
    if not (len(values) > 1 and np.ptp(values) > 0):
        return "values are all alike"
    if quantity.logarithmic and not values.min() > 0:
        return "values are not all positive, and their logarithms are said to be told"
    if not (quantity.strength.min() > 0 and quantity.scales.length_mm > 0):
        return "strength or scales/length is not positive"
    return "" if 0 < low <= high else "quantiles are not positive and rising"


def _calibration(entries: Mapping[str, Entry]) -> Calibration:
    no_force_reason = Reading(entries).text(_WHY_NOT)
    kept_entries = {
        path: entry
        for path, entry in entries.items()
        if path != _WHY_NOT and not (no_force_reason and path.startswith("force/"))
    }
    calibration: Calibration = _CODEC.read(Reading(kept_entries), Calibration, "", {"no_force": no_force_reason})
    reconstruction = calibration.reconstruction
    if reconstruction.matrix.shape != reconstruction.problem.jacobian.T.shape:
        raise CalibrationError(
            f"reconstruction/matrix of {reconstruction.matrix.shape} does not fit its mesh and readings"
        )
    for problem in problems(calibration, ""):
        raise CalibrationError(problem)
    if calibration.force is not None:
        for problem in _list_force_problems(calibration.force):
            raise CalibrationError(problem)
        if calibration.place is not None:
            rows = calibration.force.merging.shape[0]
            for problem in _place_problems(calibration.place.learned, rows, "force/merging"):
                raise CalibrationError(problem)
        _check_usable(calibration)
    return calibration


def _write_electrodes(out: Entries, group: str, electrodes: Electrodes) -> None:
    _CODEC.write(out, electrodes, f"{group}/")
    out[f"{group}/count"] = Entry(PURE, np.asarray(electrodes.count))


def _read_electrodes(read: Reading, group: str) -> Electrodes:
    kind = PlacedElectrodes if read.has(f"{group}/positions") else ElectrodeLayout
    electrodes: Electrodes = _CODEC.read(read, kind, f"{group}/")
    return electrodes


def _write_mesh(out: Entries, group: str, mesh: Mesh) -> None:
    for name in MESH_ARRAYS[:4]:
        _write_array(out, f"{group}{name.removesuffix('_mm')}", name, mesh_arrays(mesh)[name])
    counts = f"{group}electrode_edge_counts"
    out[counts] = Entry(PURE, out[counts].value)


def _read_mesh(read: Reading, group: str) -> Mesh:
    names = MESH_ARRAYS[:4]
    return mesh_of_arrays({name: _read_array(read, f"{group}{name.removesuffix('_mm')}", name) for name in names})


def _write_given_mesh(out: Entries, group: str, mesh: GivenMesh | None) -> None:
    for name, array in {} if mesh is None else mesh_arrays(mesh.mesh).items():
        _write_array(out, f"{group}{name}", name, array)


def _write_array(out: Entries, path: str, name: str, array: NDArray[Any]) -> None:
    if name in MESH_INTEGERS:
        out[path] = Entry(INDEX, np.array(array, dtype=np.int64))
    else:
        out[path] = Entry("mm", array + 0.0)


def _read_array(read: Reading, path: str, name: str) -> NDArray[Any]:
    return read.array(path, np.int64) if name in MESH_INTEGERS else read.numbers(path)


def _read_given_mesh(read: Reading, group: str) -> GivenMesh | None:
    if not read.has(f"{group}nodes_mm"):
        return None
    return GivenMesh.from_mesh(
        mesh_of_arrays({name: _read_array(read, f"{group}{name}", name) for name in MESH_ARRAYS})
    )


def _write_relaxations(out: Entries, group: str, relaxations: tuple[LoadRelaxation, ...]) -> None:
    """Write one group per signal, so that every dataset has one unit; ``number`` is the index among all of them."""
    for signal in dict.fromkeys(relaxation.signal for relaxation in relaxations):
        numbers = [number for number, relaxation in enumerate(relaxations) if relaxation.signal == signal]
        members = [relaxations[number] for number in numbers]
        units = {relaxation.unit for relaxation in members}
        if not signal.isidentifier():
            raise CalibrationError(f"a relaxing signal is named {signal!r}; letters, digits and _ are allowed")
        if len(units) != 1:
            raise CalibrationError(f"relaxations of {signal} have several units: {', '.join(sorted(units))}")
        out[f"{group}{signal}/number"] = Entry(INDEX, np.array(numbers, dtype=np.int64))
        _CODEC.write_list(out, LoadRelaxation, members, f"{group}{signal}/", units.pop())


def _read_relaxations(read: Reading, group: str) -> tuple[LoadRelaxation, ...]:
    numbered: list[tuple[int, LoadRelaxation]] = []
    for signal in read.groups(group[:-1]):
        group_path = f"{group}{signal}/"
        above = {"signal": signal, "unit": read.units(f"{group_path}offset")}
        members = _CODEC.read_list(read, LoadRelaxation, group_path, above)
        numbered += zip(read.array(f"{group_path}number", np.int64).tolist(), members, strict=True)
    numbered.sort(key=lambda pair: pair[0])
    if [number for number, _ in numbered] != list(range(len(numbered))):
        raise CalibrationError("the numbers of the relaxations are not 0, 1, 2, … over all signals")
    return tuple(relaxation for _, relaxation in numbered)


_IRREGULAR: Final[Mapping[Any, Irregular]] = {
    Electrodes: (_write_electrodes, _read_electrodes),
    Mesh: (_write_mesh, _read_mesh),
    GivenMesh | None: (_write_given_mesh, _read_given_mesh),
    tuple[LoadRelaxation, ...]: (_write_relaxations, _read_relaxations),
}
_CODEC: Final = Codec(_IRREGULAR)


def _check_usable(calibration: Calibration) -> None:
    """Refuse a force model whose merging, reference, line, current or head is unusable."""
    model, used_readings = calibration.force, calibration.reconstruction.problem.used
    if model is None:
        return
    shape = calibration.sensor_type.pattern.shape
    if calibration.reference.shape != shape or used_readings.shape != shape:
        raise CalibrationError(
            f"reference/voltages of {calibration.reference.shape} and reconstruction/used of"
            f" {used_readings.shape} are not those of {shape[0]} drive and {shape[1]} measure pairs"
        )
    if model.merging.shape[1] != int(used_readings.sum()):
        raise CalibrationError(
            f"force/merging is for {model.merging.shape[1]} readings, {int(used_readings.sum())} are used"
        )
    if not np.isfinite(calibration.reference[used_readings]).all():
        raise CalibrationError("reference/voltages holds a used reading that is not a finite number")
    line, validity = calibration.against_stress, calibration.validity
    line_errors = (line.slope.stderr, line.intercept.stderr, line.covariance, *(validity.force_N or ()))
    numbers = (line.slope.value, line.intercept.value, validity.radius_mm, *(x for x in line_errors if x is not None))
    if not np.isfinite(numbers).all() or line.slope.value == 0:
        raise CalibrationError("quasi_static/against_stress or validity holds what no force can be worked out from")
    positive = (calibration.current_A, calibration.indenter.diameter_mm, calibration.indenter.squared_radius_mm2)
    if not all(np.isfinite(value) and value > 0 for value in positive):
        raise CalibrationError("reference/current or indenter is not a positive number")


def _list_force_problems(model: ForceModel) -> Iterator[str]:
    nodes_on_sheet = model.node[model.node >= 0]
    if (model.node < -1).any() or not np.array_equal(np.sort(nodes_on_sheet), np.arange(len(model.templates))):
        yield f"force/node does not name each of {len(model.templates)} templates once, and −1 elsewhere"
    if not model.fits.any():
        yield "force/fits allows a head nowhere"
    xx, xy, yy = model.turning.T
    if not ((xx > 0) & (xx * yy - xy**2 > 0)).all():
        yield "force/turning is not positive definite somewhere: no place could be found there"
    if not model.lattice.spacing_mm > 0:
        yield f"force/lattice/spacing of {model.lattice.spacing_mm:g} mm is not positive"
    if not np.allclose(np.linalg.norm(model.templates, axis=1), 1, rtol=0, atol=_LENGTH_TOLERANCE):
        yield "force/templates are not of the length one"
    if not (model.threshold > 0 and model.misfit > 0 and 0 <= model.stress_kPa[0] <= model.stress_kPa[1]):
        yield "force/threshold, force/misfit or force/stress is out of range"
    for name, kernel in (("loading", model.loading), ("unloading", model.unloading)):
        if kernel is None:
            continue
        tau_s = kernel.time_constants_s
        if not ((tau_s > 0).all() and (np.diff(tau_s) > 0).all() and kernel.scatter_freedom > 0):
            yield f"force/{name} holds time constants that are not positive and rising, or no freedom"
