"""The EIT engine beside pyEIT and EIDORS on the same work: ``python -m benchmarks.engine``; needs pyEIT.

Forward solutions of a disc with 16 electrodes against the exact ones, and images of one tank recording. pyEIT runs
here, in turn with the engine. EIDORS needs Octave or MATLAB: its figures are those of ``../shared/oracle``, where it
ran beside pyEIT, and its share of pyEIT's time in that run is what carries over. Meshes are made beforehand, and not
timed.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import scipy.io
from numpy.typing import NDArray

from benchmarks.peers import Peer, peer
from benchmarks.timing import compare, fastest
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.imaging.contours import contour_regions
from cbsr_qa.eit.inverse.dual import dual_matrix
from cbsr_qa.eit.inverse.one_step import ridge_reconstruction
from cbsr_qa.eit.inverse.priors import Prior, noser
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.regularisation import Criterion, Regularisation
from cbsr_qa.eit.mesh.pyeit import import_pyeit_mesh, import_pyeit_protocol
from cbsr_qa.eit.mesh.sheet import sheet_mesh

Array = NDArray[np.float64]

PHANTOM = Path(__file__).resolve().parents[2] / "shared" / "data" / "tank" / "phantom_16elec_1planeB.mat"
_PLAIN = ConcentricSheet(1.0, 1.0)
_INCLUSION = ConcentricSheet(1.0, 1.0, 0.5, 3.0)
_CONTACT = 0.05
_ARCS = SensorType(
    "arcs", 1.0, 1.0, ElectrodeLayout(16, ElectrodeKind.ARC, 1.0, 0.1, 0.0, True), adjacent_pattern(16), Response.AUTO
)  # fmt: skip
#: EIDORS on Octave beside pyEIT's 186 ms: elements, errors, share of pyEIT's time to solve.
_EIDORS = (
    ("EIDORS, points, first order", 6400, 5.2e-4, 5.0e-4, 50 / 186),
    ("EIDORS, complete electrodes, first order", 12717, 7.5e-4, 3.2e-3, 43 / 186),
)
_PAIL = replace(_ARCS, name="pail", electrodes=ElectrodeLayout(16, ElectrodeKind.ARC, 1.0, 0.07, 0.0, True))
#: Jacobian and matrix: EIDORS's 0.86 s with 2304 elements beside pyEIT's 1.15 s. It was not run on the recording.
_EIDORS_IMAGE = f"| EIDORS | 2304 | – | – | {0.86 / 1.15:.2g} |"
_LAMBDA = 0.1  # pyEIT's lamb is its square


def forward_rows(*, timed: bool = True) -> Iterator[str]:
    """Rows of the table of forward solutions; without times, their column is empty."""
    other = peer()
    homogeneous, included = _peer_errors(other)
    theirs = other.forward()
    solve_theirs = lambda: theirs.solve_eit(perm=1.0)  # noqa: E731
    peer_s = fastest(solve_theirs, 5) if timed else 1.0
    yield _row("pyEIT 1.2.4, points, first order", len(other.mesh.element), homogeneous, included, 1.0)
    sheet, read = import_pyeit_mesh(other.mesh), import_pyeit_protocol(other.protocol, 16)
    points = point_model(sheet.mesh, sheet.electrode_nodes, read.pattern, sheet.conductance)
    size = len(sheet.mesh.elements)
    found = [read.list_readings(model.voltages()) for model in (points, _press_middle(points))]
    exact = [other.exact_readings(one) for one in (_PLAIN, _INCLUSION)]
    errors = [_error(one, two) for one, two in zip(found, exact, strict=True)]
    share = _share(lambda: points.with_values().voltages(), solve_theirs, peer_s) if timed else None
    yield _row("this engine, points, first order, pyEIT's mesh", size, *errors, share)
    mesh = sheet_mesh(_ARCS, size_mm=0.12, order=2)
    arcs = ForwardModel(mesh, _ARCS.pattern, np.ones(len(mesh.elements)), np.full(16, _CONTACT), order=2)
    used = _ARCS.pattern.usable()
    errors = [
        _error(model.voltages()[used], model.readings(_exact_arcs(one))[used])
        for model, one in ((arcs, _PLAIN), (_press_middle(arcs), _INCLUSION))
    ]
    share = _share(lambda: arcs.with_values().voltages(), solve_theirs, peer_s) if timed else None
    yield _row("this engine, complete electrodes, second order", len(mesh.elements), *errors, share)
    for row in _EIDORS:
        yield _row(*row)


def tank_rows(*, timed: bool = True) -> Iterator[str]:
    """Rows of the table of images: balls 7 cm from the middle of a pail of 15 cm, r/R 0.467."""
    content = scipy.io.loadmat(PHANTOM)
    frames = {name: content[name].reshape(16, 16).astype(float) for name in ("vvRef", "vvAvg2", "vvAvg3")}
    other = peer(0.05)
    jac = other.jac()
    sheet = import_pyeit_mesh(other.mesh)
    mesh, electrodes_at = sheet.mesh, sheet.mesh.nodes_mm[sheet.electrode_nodes]
    signs = np.sign(other.readings())
    scale = _scale(frames["vvRef"][_PAIL.pattern.usable()], signs * other.readings())
    peer_s = fastest(other.jac, 1) if timed else 1.0
    theirs = -np.asarray(jac.H)
    yield _tank_row("pyEIT 1.2.4, JAC", mesh, electrodes_at, lambda y: theirs @ (signs * y / scale), frames, 1.0)
    share = fastest(lambda: _same_matrix(other), 5) / peer_s if timed else None
    matrix = _same_matrix(other)
    yield _tank_row(
        "this engine, pyEIT's mesh, prior and λ",
        mesh,
        electrodes_at,
        lambda y: matrix @ (signs * y / scale),
        frames,
        share,
    )
    problem = imaging_problem(_PAIL, image_size_mm=0.06)
    own, _ = ridge_reconstruction(
        "noser",
        problem,
        lambda given: Prior.diagonal(noser(given.jacobian, 0.5)),
        Regularisation(Criterion.NOISE_FIGURE, 0.5, None, "hyperparameter"),
    )
    signs_here = np.sign(problem.reference)
    scale_here = _scale(frames["vvRef"][problem.used], np.abs(problem.reference))
    yield _tank_row(
        "this engine, own mesh, λ by noise figure 0.5",
        problem.mesh,
        _PAIL.electrodes.positions_mm(),
        lambda y: own.matrix @ (signs_here * y / scale_here),
        frames,
        None,
    )
    yield _EIDORS_IMAGE


def _row(name: str, elements: int, homogeneous: float, included: float, share: float | None) -> str:
    time = "" if share is None else f"{share:.2g}"
    return f"| {name} | {elements} | {homogeneous:.1e} | {included:.1e} | {time} |"


def _tank_row(
    name: str,
    mesh: Mesh,
    electrodes_at: Array,
    image: Callable[[Array], Array],
    frames: dict[str, Array],
    share: float | None,
) -> str:
    used = _PAIL.pattern.usable()
    turned, out = [], []
    for shown, electrodes in (("vvAvg2", (4,)), ("vvAvg3", (0, 4))):
        values = image(np.abs(frames[shown][used]) - np.abs(frames["vvRef"][used]))
        places = [region.centre_mm() for region in contour_regions(Image(mesh, -values), 0.5)[: len(electrodes)]]
        for electrode in electrodes:
            there = complex(*electrodes_at[electrode])
            nearest = min((complex(*place) for place in places), key=lambda place: abs(place - there))
            turned.append(abs(float(np.angle(nearest / there))) / (np.pi / 8))
            out.append(abs(nearest))
    places_out = ", ".join(f"{one:.2f}" for one in out)
    time = "" if share is None else f"{share:.2g}"
    return f"| {name} | {len(mesh.elements)} | {max(turned):.2f} | {places_out} | {time} |"


def _same_matrix(other: Peer) -> Array:
    """Set up JAC's image here, from pyEIT's mesh in memory on: each reading once, where two are reciprocal."""
    sheet, read = import_pyeit_mesh(other.mesh), import_pyeit_protocol(other.protocol, 16)
    model = point_model(sheet.mesh, sheet.electrode_nodes, read.pattern, sheet.conductance)
    group, sign = read.pattern.reading_groups()
    _, first, number = np.unique(group[read.drive, read.measure], return_index=True, return_inverse=True)
    signs = sign[read.drive, read.measure]
    jacobian = signs[first, None] * model.jacobian_rows(read.drive[first], read.measure[first])
    count = np.bincount(number)
    folded = dual_matrix(jacobian, noser(np.sqrt(2) * jacobian, 0.5), _LAMBDA, 1 / count)
    return np.asarray(folded[:, number] * (signs / count[number]))


def _press_middle(model: ForwardModel) -> ForwardModel:
    load = cover(model.elements, RoundFootprint(0.0, 0.0, 0.5))
    return model.with_change_on(load.elements, load.change(model.conductance, 2.0))


def _peer_errors(other: Peer) -> tuple[float, float]:
    """Of pyEIT's readings, homogeneous and with the inclusion, whose elements are those with their middle in it."""
    middles = np.asarray(other.mesh.node)[np.asarray(other.mesh.element)].mean(axis=1)[:, :2]
    included = np.where(np.hypot(*middles.T) < 0.5, 3.0, 1.0)
    exact = (other.exact_readings(sheet) for sheet in (_PLAIN, _INCLUSION))
    plain, pressed = (_error(other.readings(given), one) for given, one in zip((None, included), exact, strict=True))
    return plain, pressed


def _exact_arcs(sheet: ConcentricSheet) -> Array:
    angles = _ARCS.electrodes.angles_rad() if isinstance(_ARCS.electrodes, ElectrodeLayout) else np.zeros(0)
    return arc_transfer_impedance(sheet, angles, 0.05, _CONTACT, modes=30, harmonics=60_000)


def _error(found: Array, exact: Array) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def _scale(sensor: Array, model: Array) -> float:
    return float(np.abs(sensor) @ model / (model @ model))


def _share(ours: Callable[[], object], theirs: Callable[[], object], peer_s: float) -> float:
    compared = compare("", ("", ours), ("", theirs), repeats=20)
    return compared.ours_s / min(compared.theirs_s, peer_s)


def main() -> None:
    if find_spec("pyeit") is None:
        sys.exit("skipped: pyEIT is not installed (pip install 'cbsr-qa[pyeit]')")
    print("| forward solution | elements | error, homogeneous | error, inclusion | time |")
    print("| --- | --- | --- | --- | --- |")
    for row in forward_rows():
        print(row)
    if not PHANTOM.exists():
        sys.exit(f"the tank is skipped: its recording is not at {PHANTOM}")
    print("\n| image of the tank | elements | angle off | r/R | time |\n| --- | --- | --- | --- | --- |")
    for row in tank_rows():
        print(row)


if __name__ == "__main__":
    main()
