"""From the entries of a calibration file (schema versions 1 and 2) back to the calibration."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import Entry, Reading, read_choice
from cbsr_qa.calibration.file.force import check_usable, read_force
from cbsr_qa.domain import CalibrationError, RefusedError
from cbsr_qa.domain.geometry import Polygon
from cbsr_qa.domain.results import (
    BaselineConductance,
    Calibration,
    FitStatus,
    ImagingProblem,
    LinearReconstruction,
    LoadRelaxation,
    OverlapBand,
    RelaxationFit,
    SettlingSummary,
    SettlingTime,
    Validity,
)
from cbsr_qa.domain.run import Indenter
from cbsr_qa.domain.sensor import (
    INTEGERS as MESH_INTEGERS,
    NAMES as MESH_ARRAYS,
    DrivePattern,
    ElectrodeKind,
    ElectrodeLayout,
    Electrodes,
    GivenMesh,
    Mesh,
    Parameter,
    PlacedElectrodes,
    QuasiStatic,
    Response,
    SensorIdentity,
    SensorType,
    mesh_of_arrays,
)


def decode(entries: Mapping[str, Entry]) -> Calibration:
    """Return the calibration that some entries describe.

    Raises
    ------
    CalibrationError
        If an entry is missing, of another type, of another length than its neighbours, or not allowed.
    """
    try:
        return _calibration(Reading(entries))
    except CalibrationError:
        raise
    except (RefusedError, ValueError, IndexError, TypeError, ArithmeticError) as error:
        raise CalibrationError(f"the content contradicts itself: {error}") from error


def _calibration(read: Reading) -> Calibration:
    sensor_type = _sensor_type(read)
    force, no_force = read_force(read)
    calibration = Calibration(
        calibration=read.text("identity/calibration"),
        run=read.text("identity/run"),
        issued_at=read.text("identity/issued_at"),
        sensor=SensorIdentity(
            read.text("identity/serial"), read.text("identity/batch"), read.text("identity/sensor_type")
        ),
        sensor_type=sensor_type,
        indenter=_indenter(read),
        reference=read.numbers("reference/voltages"),
        current_A=read.number("reference/current"),
        scale=read.number("reference/scale"),
        reconstruction=_reconstruction(read, sensor_type),
        response=Response(read.text("image/response")),
        noise_floor=read.number("image/noise_floor"),
        mask=read.number("image/mask"),
        baseline=_baseline(read),
        against_stress=_quasi_static(read, "against_stress"),
        against_strain=_quasi_static(read, "against_strain"),
        assumed=read.texts("assumed"),
        settling=_settling(read),
        overlap_bands=_bands(read),
        overlap_threshold=read.number("area_overlap/threshold"),
        validity=_validity(read),
        simulated=read.texts("identity/simulated"),
        relaxations=_relaxations(read),
        size_ratio=read.pair("area_overlap/size_ratio"),
        noise_figure=read.maybe("image/measured_noise_figure"),
        force=force,
        no_force=no_force,
    )
    check_usable(calibration)
    return calibration


def _indenter(read: Reading) -> Indenter:
    corners = read.numbers("indenter/outline").tolist() if read.has("indenter/outline") else []
    return Indenter(read.number("indenter/diameter"), tuple((x, y) for x, y in corners))


def _sensor_type(read: Reading) -> SensorType:
    pattern = DrivePattern(
        read.integer("sensor_type/pattern/electrode_count"),
        _pairs(read.integers("sensor_type/pattern/drive")),
        _pairs(read.integers("sensor_type/pattern/measure")),
    )
    return SensorType(
        read.text("sensor_type/name"),
        read.number("sensor_type/radius"),
        read.number("sensor_type/thickness"),
        _electrodes(read),
        pattern,
        Response(read.text("sensor_type/response")),
        _polygon(read),
        _given_mesh(read),
    )


def _electrodes(read: Reading) -> Electrodes:
    group = "sensor_type/electrodes"
    kind, width_mm = ElectrodeKind(read.text(f"{group}/kind")), read.number(f"{group}/width")
    if read.has(f"{group}/positions"):
        return PlacedElectrodes(kind, _points(read.numbers(f"{group}/positions")), width_mm)
    return ElectrodeLayout(
        count=read.integer(f"{group}/count"),
        kind=kind,
        ring_radius_mm=read.number(f"{group}/ring_radius"),
        width_mm=width_mm,
        first_angle_deg=read.number(f"{group}/first_angle"),
        counterclockwise=read.flag(f"{group}/counterclockwise"),
    )


def _polygon(read: Reading) -> Polygon | None:
    if not read.has("sensor_type/outline/corners"):
        return None
    corners = _points(read.numbers("sensor_type/outline/corners"))
    return Polygon(corners, read.number("sensor_type/outline/corner_radius"))


def _given_mesh(read: Reading) -> GivenMesh | None:
    if not read.has("sensor_type/mesh/nodes_mm"):
        return None
    arrays: dict[str, NDArray[Any]] = {}
    for name in MESH_ARRAYS:
        path = f"sensor_type/mesh/{name}"
        arrays[name] = read.integers(path) if name in MESH_INTEGERS else read.numbers(path)
    return GivenMesh.of(mesh_of_arrays(arrays))


def _points(table: NDArray[np.float64]) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in table)


def _pairs(table: NDArray[np.int64]) -> tuple[tuple[int, int], ...]:
    return tuple((int(first), int(second)) for first, second in table)


def _reconstruction(read: Reading, sensor_type: SensorType) -> LinearReconstruction:
    counts = read.integers("mesh/electrode_edge_counts")
    edges = read.integers("mesh/electrode_edges")
    if int(counts.sum()) != len(edges):
        raise CalibrationError(f"mesh/electrode_edges holds {len(edges)} edges, the counts say {int(counts.sum())}")
    owned = tuple(np.split(edges, np.cumsum(counts)[:-1])) if len(counts) else ()
    problem = ImagingProblem(
        sensor_type,
        Mesh(read.numbers("mesh/nodes"), read.integers("mesh/elements"), owned),
        read.either("reconstruction/jacobian"),
        read.numbers("reconstruction/reference"),
        read.flags("reconstruction/used"),
        read.optional("reconstruction/noise_variance"),
    )
    matrix = read.either("reconstruction/matrix")
    if matrix.shape != problem.jacobian.T.shape:
        raise CalibrationError(f"reconstruction/matrix of {matrix.shape} does not fit its mesh and readings")
    method = read.text("reconstruction/method")
    return LinearReconstruction(method, problem, matrix, read_choice(read, method))


def _baseline(read: Reading) -> tuple[BaselineConductance, ...]:
    group = "baseline_conductance"
    columns = zip(
        read.texts(f"{group}/location"),
        read.numbers(f"{group}/x").tolist(),
        read.numbers(f"{group}/y").tolist(),
        read.maybes(f"{group}/value"),
        read.maybes(f"{group}/stderr"),
        read.integers(f"{group}/loads").tolist(),
        read.texts(f"{group}/why"),
        strict=True,
    )
    return tuple(BaselineConductance(*row) for row in columns)


def _quasi_static(read: Reading, name: str) -> QuasiStatic:
    def parameter(part: str) -> Parameter:
        path = f"quasi_static/{name}/{part}"
        return Parameter(read.number(path), read.maybe(f"{path}_stderr"), read.text(f"{path}_source"))

    return QuasiStatic(parameter("slope"), parameter("intercept"), read.maybe(f"quasi_static/{name}/covariance"))


def _settling(read: Reading) -> tuple[SettlingSummary, ...]:
    columns = zip(
        read.texts("settling/signal"),
        read.flags("settling/loading").tolist(),
        read.maybes("settling/mean"),
        read.maybes("settling/deviation"),
        read.integers("settling/accepted").tolist(),
        read.integers("settling/censored").tolist(),
        read.integers("settling/rejected").tolist(),
        strict=True,
    )
    return tuple(SettlingSummary(*row) for row in columns)


def _relaxations(read: Reading) -> tuple[LoadRelaxation, ...]:
    numbered = [pair for signal in read.groups("relaxation") for pair in _relaxations_of(read, signal)]
    numbered.sort(key=lambda pair: pair[0])
    if [number for number, _ in numbered] != list(range(len(numbered))):
        raise CalibrationError("the numbers of the relaxations are not 0, 1, 2, … over all signals")
    return tuple(relaxation for _, relaxation in numbered)


def _relaxations_of(read: Reading, signal: str) -> list[tuple[int, LoadRelaxation]]:
    at = f"relaxation/{signal}"
    unit = read.units(f"{at}/offset")
    columns = zip(
        read.integers(f"{at}/number").tolist(),
        read.texts(f"{at}/phase"),
        [None if load < 0 else load for load in read.integers(f"{at}/load").tolist()],
        read.texts(f"{at}/location"),
        read.integers(f"{at}/trial").tolist(),
        read.maybes(f"{at}/strain"),
        read.flags(f"{at}/loading").tolist(),
        _fits(read, at),
        _settling_times(read, at),
        strict=True,
    )
    return [
        (number, LoadRelaxation(location, trial, signal, loading, fit, settling, phase, load, strain, unit))
        for number, phase, load, location, trial, strain, loading, fit, settling in columns
    ]


def _fits(read: Reading, at: str) -> list[RelaxationFit]:
    columns = zip(
        [FitStatus(status) for status in read.texts(f"{at}/status")],
        read.numbers(f"{at}/offset").tolist(),
        _unpadded(read.numbers(f"{at}/amplitudes")),
        _unpadded(read.numbers(f"{at}/time_constants")),
        read.numbers(f"{at}/offset_stderr").tolist(),
        _unpadded(read.numbers(f"{at}/time_constants_stderr")),
        read.numbers(f"{at}/r_squared").tolist(),
        read.texts(f"{at}/why"),
        strict=True,
    )
    return [RelaxationFit(*row) for row in columns]


def _settling_times(read: Reading, at: str) -> list[SettlingTime]:
    columns = zip(
        read.maybes(f"{at}/settling_time"),
        read.flags(f"{at}/settling_censored").tolist(),
        read.numbers(f"{at}/settling_band").tolist(),
        read.texts(f"{at}/settling_why"),
        strict=True,
    )
    return [SettlingTime(*row) for row in columns]


def _unpadded(table: NDArray[np.float64]) -> list[tuple[float, ...]]:
    return [tuple(row[~np.isnan(row)].tolist()) for row in table]


def _bands(read: Reading) -> tuple[OverlapBand, ...]:
    columns = zip(
        read.texts("area_overlap/band"),
        read.numbers("area_overlap/lower").tolist(),
        read.numbers("area_overlap/upper").tolist(),
        strict=True,
    )
    return tuple(OverlapBand(*row) for row in columns)


def _validity(read: Reading) -> Validity:
    strain = read.pair("validity/strain")
    if strain is None:
        raise CalibrationError("validity/strain is empty")
    return Validity(
        force_N=read.pair("validity/force"),
        strain=strain,
        temperature_C=read.pair("validity/temperature"),
        radius_mm=read.number("validity/radius"),
        reduced=read.texts("validity/reduced"),
    )
