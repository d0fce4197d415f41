"""A calibration as entries of its file, and back: schema version 3, or the lowest that has all it holds.

What files of before held otherwise is brought to the form of now when it is read, and back when it is written, so
that what was issued keeps its digests: the regularisation parameter without name and criterion, which its method
implies, and no word of force.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import INDEX, PURE, TEXT, Entry, Reading
from cbsr_qa.calibration.file.fields import Codec, Entries, Irregular, problems
from cbsr_qa.calibration.file.force import check_usable, force_problems
from cbsr_qa.domain import CalibrationError, RefusedError
from cbsr_qa.domain.results import Calibration, LoadRelaxation
from cbsr_qa.domain.sensor import (
    INTEGERS as MESH_INTEGERS,
    NAMES as MESH_ARRAYS,
    ElectrodeLayout,
    Electrodes,
    GivenMesh,
    Mesh,
    PlacedElectrodes,
    mesh_arrays,
    mesh_of_arrays,
)

_WHY_NOT: Final = "force/none"
_METHOD: Final = "reconstruction/method"
_NAME: Final = "reconstruction/regularisation_name"
_CRITERION: Final = "reconstruction/regularisation_criterion"

#: What methods call their parameter where a file does not; every other one has a λ.
_CALLED: Final = {
    "truncated-svd": "components kept",
    "linear-back-projection": "no parameter",
    "pyeit-jac": "pyEIT's lamb",
    "pyeit-greit": "pyEIT's lamb",
}


def encode(calibration: Calibration) -> Mapping[str, Entry]:
    """Return everything a calibration holds as entries by path.

    Raises
    ------
    CalibrationError
        If its matrix was prepared for another sensor type than it names.
    """
    prepared_for = calibration.reconstruction.problem.sensor_type
    if prepared_for != calibration.sensor_type:
        raise CalibrationError(
            f"the reconstruction was prepared for sensor type {prepared_for.name!r},"
            f" the calibration is for {calibration.sensor_type.name!r}"
        )
    entries: Entries = {}
    _CODEC.write(entries, calibration, "")
    if calibration.force is not None or calibration.no_force:
        entries[_WHY_NOT] = Entry(TEXT, calibration.no_force)
    choice = calibration.reconstruction.choice
    if not choice.criterion and choice.name == _implied(calibration.reconstruction.method):
        del entries[_NAME], entries[_CRITERION]
    return entries


def decode(entries: Mapping[str, Entry]) -> Calibration:
    """Return the calibration that some entries describe.

    Raises
    ------
    CalibrationError
        If an entry is missing, of another type, of another length than its neighbours, or not allowed.
    """
    try:
        return _calibration(entries)
    except CalibrationError:
        raise
    except (RefusedError, ValueError, IndexError, TypeError, ArithmeticError) as error:
        raise CalibrationError(f"the content contradicts itself: {error}") from error


def _calibration(entries: Mapping[str, Entry]) -> Calibration:
    held, read = dict(entries), Reading(entries)
    why = read.text(_WHY_NOT) if read.inside("force/") else ""
    held = {
        path: entry for path, entry in held.items() if path != _WHY_NOT and not (why and path.startswith("force/"))
    }
    if not (read.has(_NAME) or read.has(_CRITERION)):
        held |= {_NAME: Entry(TEXT, _implied(read.text(_METHOD))), _CRITERION: Entry(TEXT, "")}
    calibration: Calibration = _CODEC.read(Reading(held), Calibration, "", {"no_force": why})
    reconstruction = calibration.reconstruction
    if reconstruction.matrix.shape != reconstruction.problem.jacobian.T.shape:
        raise CalibrationError(
            f"reconstruction/matrix of {reconstruction.matrix.shape} does not fit its mesh and readings"
        )
    for problem in problems(calibration, ""):
        raise CalibrationError(problem)
    if calibration.force is not None:
        for problem in force_problems(calibration.force):
            raise CalibrationError(problem)
        check_usable(calibration)
    return calibration


def _implied(method: str) -> str:
    return _CALLED.get(method, "λ")


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
    return mesh_of_arrays(
        {
            "nodes_mm": read.numbers(f"{group}nodes"),
            **{name: read.integers(f"{group}{name}") for name in MESH_ARRAYS[1:4]},
        }
    )


def _write_given_mesh(out: Entries, group: str, mesh: GivenMesh | None) -> None:
    for name, array in {} if mesh is None else mesh_arrays(mesh.mesh).items():
        _write_array(out, f"{group}{name}", name, array)


def _write_array(out: Entries, path: str, name: str, array: NDArray[Any]) -> None:
    if name in MESH_INTEGERS:
        out[path] = Entry(INDEX, np.array(array, dtype=np.int64))
    else:
        out[path] = Entry("mm", array + 0.0)


def _read_given_mesh(read: Reading, group: str) -> GivenMesh | None:
    if not read.has(f"{group}nodes_mm"):
        return None
    return GivenMesh.of(
        mesh_of_arrays(
            {
                name: read.integers(f"{group}{name}") if name in MESH_INTEGERS else read.numbers(f"{group}{name}")
                for name in MESH_ARRAYS
            }
        )
    )


def _write_relaxations(out: Entries, group: str, relaxations: tuple[LoadRelaxation, ...]) -> None:
    """One group per signal, so that every dataset has one unit; ``number`` is the place among all of them."""
    for signal in dict.fromkeys(one.signal for one in relaxations):
        numbers = [number for number, one in enumerate(relaxations) if one.signal == signal]
        members = [relaxations[number] for number in numbers]
        units = {one.unit for one in members}
        if not signal.isidentifier():
            raise CalibrationError(f"a relaxing signal is named {signal!r}; letters, digits and _ are allowed")
        if len(units) != 1:
            raise CalibrationError(f"relaxations of {signal} have several units: {', '.join(sorted(units))}")
        out[f"{group}{signal}/number"] = Entry(INDEX, np.array(numbers, dtype=np.int64))
        _CODEC.write_list(out, LoadRelaxation, members, f"{group}{signal}/", units.pop())


def _read_relaxations(read: Reading, group: str) -> tuple[LoadRelaxation, ...]:
    numbered: list[tuple[int, LoadRelaxation]] = []
    for signal in read.groups(group[:-1]):
        at = f"{group}{signal}/"
        above = {"signal": signal, "unit": read.units(f"{at}offset")}
        members = _CODEC.read_list(read, LoadRelaxation, at, above)
        numbered += zip(read.integers(f"{at}number").tolist(), members, strict=True)
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
