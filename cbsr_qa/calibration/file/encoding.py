"""From a calibration to the entries of its file (schema version 3, or the lowest that has all it holds)."""

from collections.abc import Mapping, Sequence

import numpy as np

from cbsr_qa.calibration.file.content import Entry, Writing, write_choice
from cbsr_qa.calibration.file.force import write_force
from cbsr_qa.domain import CalibrationError
from cbsr_qa.domain.results import Calibration, LinearReconstruction, LoadRelaxation, RelaxationFit
from cbsr_qa.domain.sensor import (
    INTEGERS as MESH_INTEGERS,
    Electrodes,
    Parameter,
    PlacedElectrodes,
    QuasiStatic,
    SensorType,
    mesh_arrays,
)


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
    out = Writing()
    _identity(out, calibration)
    _sensor_type(out, calibration.sensor_type)
    _reconstruction(out, calibration.reconstruction)
    _image(out, calibration)
    _baseline(out, calibration)
    _quasi_static(out, "against_stress", calibration.against_stress, "1/kPa")
    _quasi_static(out, "against_strain", calibration.against_strain, "1")
    _settling(out, calibration)
    _relaxations(out, calibration.relaxations)
    _use(out, calibration)
    write_force(out, calibration.force, calibration.no_force)
    return out.entries


def _identity(out: Writing, c: Calibration) -> None:
    out.text("identity/calibration", c.calibration)
    out.text("identity/run", c.run)
    out.text("identity/issued_at", c.issued_at)
    out.text("identity/serial", c.sensor.serial)
    out.text("identity/batch", c.sensor.batch)
    out.text("identity/sensor_type", c.sensor.sensor_type)
    out.texts("identity/simulated", c.simulated)


def _sensor_type(out: Writing, kind: SensorType) -> None:
    out.text("sensor_type/name", kind.name)
    out.number("sensor_type/radius", kind.radius_mm, "mm")
    out.number("sensor_type/thickness", kind.thickness_mm, "mm")
    out.text("sensor_type/response", kind.response)
    if kind.polygon is not None:
        out.numbers("sensor_type/outline/corners", np.array(kind.polygon.corners_mm), "mm")
        out.number("sensor_type/outline/corner_radius", kind.polygon.corner_radius_mm, "mm")
    if kind.mesh is not None:
        for name, array in mesh_arrays(kind.mesh.mesh).items():
            if name in MESH_INTEGERS:
                out.integers(f"sensor_type/mesh/{name}", array)
            else:
                out.numbers(f"sensor_type/mesh/{name}", array, "mm")
    _electrodes(out, kind.electrodes)
    out.integers("sensor_type/pattern/electrode_count", kind.pattern.electrode_count, "1")
    out.integers("sensor_type/pattern/drive", np.array(kind.pattern.drive))
    out.integers("sensor_type/pattern/measure", np.array(kind.pattern.measure))


def _electrodes(out: Writing, electrodes: Electrodes) -> None:
    group = "sensor_type/electrodes"
    out.integers(f"{group}/count", electrodes.count, "1")
    out.text(f"{group}/kind", electrodes.kind)
    out.number(f"{group}/width", electrodes.width_mm, "mm")
    if isinstance(electrodes, PlacedElectrodes):
        out.numbers(f"{group}/positions", electrodes.positions_mm(), "mm")
        return
    out.number(f"{group}/ring_radius", electrodes.ring_radius_mm, "mm")
    out.number(f"{group}/first_angle", electrodes.first_angle_deg, "deg")
    out.flags(f"{group}/counterclockwise", electrodes.counterclockwise)


def _reconstruction(out: Writing, reconstruction: LinearReconstruction) -> None:
    problem, mesh = reconstruction.problem, reconstruction.problem.mesh
    out.text("reconstruction/method", reconstruction.method)
    out.shortest("reconstruction/matrix", reconstruction.matrix, "A.Ohm/V")
    write_choice(out, reconstruction.method, reconstruction.choice)
    out.shortest("reconstruction/jacobian", problem.jacobian, "V/(A.Ohm)")
    out.numbers("reconstruction/reference", problem.reference, "V/(A.Ohm)")
    out.flags("reconstruction/used", problem.used)
    out.optional("reconstruction/noise_variance", problem.noise_variance)
    out.numbers("mesh/nodes", mesh.nodes_mm, "mm")
    out.integers("mesh/elements", mesh.elements)
    edges = mesh.electrode_edges
    joined = np.concatenate(edges) if edges else np.empty((0, 2), dtype=np.int64)
    out.integers("mesh/electrode_edges", joined)
    out.integers("mesh/electrode_edge_counts", [len(edge) for edge in edges], "1")


def _image(out: Writing, c: Calibration) -> None:
    out.numbers("reference/voltages", c.reference, "V")
    out.number("reference/current", c.current_A, "A")
    out.number("reference/scale", c.scale, "A.Ohm")
    out.text("image/response", c.response)
    out.number("image/noise_floor", c.noise_floor)
    out.number("image/mask", c.mask)
    out.number("image/measured_noise_figure", c.noise_figure)


def _baseline(out: Writing, c: Calibration) -> None:
    places = c.baseline
    out.texts("baseline_conductance/location", [p.location for p in places])
    out.numbers("baseline_conductance/x", [p.x_mm for p in places], "mm")
    out.numbers("baseline_conductance/y", [p.y_mm for p in places], "mm")
    out.numbers("baseline_conductance/value", [p.value for p in places])
    out.numbers("baseline_conductance/stderr", [p.stderr for p in places])
    out.integers("baseline_conductance/loads", [p.loads for p in places], "1")
    out.texts("baseline_conductance/why", [p.why for p in places])


def _quasi_static(out: Writing, name: str, fit: QuasiStatic, slope_units: str) -> None:
    def parameter(part: str, value: Parameter, units: str) -> None:
        out.number(f"quasi_static/{name}/{part}", value.value, units)
        out.number(f"quasi_static/{name}/{part}_stderr", value.stderr, units)
        out.text(f"quasi_static/{name}/{part}_source", value.source)

    parameter("slope", fit.slope, slope_units)
    parameter("intercept", fit.intercept, "1")
    out.number(f"quasi_static/{name}/covariance", fit.covariance, slope_units)  # β has the unit 1


def _settling(out: Writing, c: Calibration) -> None:
    out.texts("settling/signal", [s.signal for s in c.settling])
    out.flags("settling/loading", [s.loading for s in c.settling])
    out.numbers("settling/mean", [s.mean_s for s in c.settling], "s")
    out.numbers("settling/deviation", [s.deviation_s for s in c.settling], "s")
    out.integers("settling/accepted", [s.accepted for s in c.settling], "1")
    out.integers("settling/censored", [s.censored for s in c.settling], "1")
    out.integers("settling/rejected", [s.rejected for s in c.settling], "1")


def _relaxations(out: Writing, seen: Sequence[LoadRelaxation]) -> None:
    """One group per signal, so that every dataset has one unit; ``number`` is the place among all of them."""
    groups: dict[str, list[tuple[int, LoadRelaxation]]] = {}
    for number, relaxation in enumerate(seen):
        groups.setdefault(relaxation.signal, []).append((number, relaxation))
    for signal, members in groups.items():
        units = {relaxation.unit for _, relaxation in members}
        if not signal.isidentifier():
            raise CalibrationError(f"a relaxing signal is named {signal!r}; letters, digits and _ are allowed")
        if len(units) != 1:
            raise CalibrationError(f"relaxations of {signal} have several units: {', '.join(sorted(units))}")
        at = f"relaxation/{signal}"
        out.integers(f"{at}/number", [number for number, _ in members])
        _loads(out, at, [relaxation for _, relaxation in members])
        _fits(out, at, [relaxation.fit for _, relaxation in members], units.pop())
        _settling_times(out, at, [relaxation for _, relaxation in members])


def _loads(out: Writing, at: str, seen: Sequence[LoadRelaxation]) -> None:
    out.texts(f"{at}/phase", [r.phase for r in seen])
    out.integers(f"{at}/load", [-1 if r.load is None else r.load for r in seen])
    out.texts(f"{at}/location", [r.location for r in seen])
    out.integers(f"{at}/trial", [r.trial for r in seen])
    out.numbers(f"{at}/strain", [r.strain for r in seen])
    out.flags(f"{at}/loading", [r.loading for r in seen])


def _fits(out: Writing, at: str, fits: Sequence[RelaxationFit], unit: str) -> None:
    out.texts(f"{at}/status", [fit.status for fit in fits])
    out.numbers(f"{at}/offset", [fit.offset for fit in fits], unit)
    out.numbers(f"{at}/offset_stderr", [fit.offset_stderr for fit in fits], unit)
    out.numbers(f"{at}/amplitudes", _padded([fit.amplitudes for fit in fits]), unit)
    out.numbers(f"{at}/time_constants", _padded([fit.time_constants_s for fit in fits]), "s")
    out.numbers(f"{at}/time_constants_stderr", _padded([fit.time_constant_stderr_s for fit in fits]), "s")
    out.numbers(f"{at}/r_squared", [fit.r_squared for fit in fits])
    out.texts(f"{at}/why", [fit.why for fit in fits])


def _settling_times(out: Writing, at: str, seen: Sequence[LoadRelaxation]) -> None:
    out.numbers(f"{at}/settling_time", [r.settling.value_s for r in seen], "s")
    out.flags(f"{at}/settling_censored", [r.settling.censored for r in seen])
    out.numbers(f"{at}/settling_band", [r.settling.band for r in seen], seen[0].unit)
    out.texts(f"{at}/settling_why", [r.settling.why for r in seen])


def _padded(rows: Sequence[tuple[float, ...]]) -> np.ndarray:
    """Rows of at most two numbers as an (n, 2) array, NaN where there is none."""
    table = np.full((len(rows), 2), np.nan)
    for index, row in enumerate(rows):
        table[index, : len(row)] = row
    return table


def _use(out: Writing, c: Calibration) -> None:
    out.texts("assumed", c.assumed)
    out.number("indenter/diameter", c.indenter.diameter_mm, "mm")
    if c.indenter.outline_mm:
        out.numbers("indenter/outline", np.array(c.indenter.outline_mm), "mm")
    out.texts("area_overlap/band", [band.name for band in c.overlap_bands])
    out.numbers("area_overlap/lower", [band.lower for band in c.overlap_bands], "%")
    out.numbers("area_overlap/upper", [band.upper for band in c.overlap_bands], "%")
    out.number("area_overlap/threshold", c.overlap_threshold, "%")
    out.optional("area_overlap/size_ratio", c.size_ratio)
    out.optional("validity/force", c.validity.force_N, "N")
    out.numbers("validity/strain", c.validity.strain)
    out.optional("validity/temperature", c.validity.temperature_C, "degC")
    out.number("validity/radius", c.validity.radius_mm, "mm")
    out.texts("validity/reduced", c.validity.reduced)
