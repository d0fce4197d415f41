"""Voltages of a sheet: how exact, how fast, and under loads."""

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers import Peer, peer
from benchmarks.rows import Row, ratio_row
from benchmarks.timing import compare, fastest, shown
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel, point_model
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.loads.pinned_disc import PinnedDisc
from cbsr_qa.eit.loads.round_load import RoundLoadModel, RoundLoads
from cbsr_qa.eit.mesh.pyeit import import_pyeit_mesh
from cbsr_qa.eit.mesh.sheet import sheet_mesh
from cbsr_qa.testing.numerics import convergence_order

TITLE = "Forward model"

Array = NDArray[np.float64]
_REPEATS = 20
_CONTACT = 0.05
_ARCS = SensorType(
    "arcs",
    1.0,
    1.0,
    ElectrodeLayout(16, ElectrodeKind.ARC, 1.0, 0.1, 0.0, True),
    adjacent_pattern(16),
    Response.AUTO,
)
_USED = _ARCS.pattern.usable()


def rows() -> Iterator[Row]:
    yield from _accuracy()
    yield _forward_solve()
    yield from _local_updates()


def notes() -> str:
    return "\n".join([*_cost_of_accuracy(), "", *_orders(), "", *_loads(), ""])


def _accuracy() -> Iterator[Row]:
    model = _arc_model(2, 0.12)
    published = f"EIDORS, published: 3.5e-4 at 43 ms; pyEIT against exact points: {peer().voltage_error():.1e}"
    yield _error_row("homogeneous disc", model, _unloaded(model), _exact(0.0), 1e-4, published)
    published = "EIDORS, published: 3.7e-3; pyEIT: 1.5e-3"
    yield _error_row(
        "disc with an inclusion r = 0.5, σ = 3 that no edge follows",
        model,
        _included(model),
        _exact(0.5),
        5e-4,
        published,
    )


def _error_row(
    what: str, model: ForwardModel, solve: Callable[[], Array], exact: Array, most: float, published: str
) -> Row:
    used, every = _errors(solve(), model.readings(exact))
    seconds = fastest(solve, _REPEATS)
    return Row(
        f"voltages of a {what}, z = 0.05, {len(model.mesh.elements)} elements of second order",
        f"≤ {most:.0e} in ≤ 20 ms",
        f"{used:.1e} of 208 readings, {every:.1e} of all 256, in {shown(seconds)}",
        published,
        used <= most and seconds <= 0.02,
    )


def _forward_solve() -> Row:
    other = peer()
    sheet = import_pyeit_mesh(other.mesh)
    model = point_model(sheet.mesh, sheet.electrode_nodes, _ARCS.pattern, sheet.conductance)
    theirs = other.forward()
    apart, count = _largest_difference(model, other), len(sheet.mesh.elements)
    return ratio_row(
        compare(
            f"forward solve, 16 drives, {count} elements; same mesh, readings alike to {apart:.0e}",
            ("assembled, factorised, solved", lambda: model.with_values().voltages()),
            ("pyEIT", lambda: theirs.solve_eit(perm=1.0)),
            repeats=_REPEATS,
        ),
        15,
    )


def _local_updates() -> Iterator[Row]:
    sensor = load_sensor_type("disc-100mm").value
    mesh = sheet_mesh(sensor, size_mm=2.25)
    model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(16, 0.2))
    local = LocalUpdate(model)
    for count, goal in ((1, 20), (9, 5)):
        loads = [cover(model.elements, RoundFootprint(x, y, 6.5)) for x, y in NINE_LOCATIONS_MM[:count]]
        elements = np.concatenate([load.elements for load in loads])
        change = np.concatenate([0.12 * load.share for load in loads])
        found = local.voltages(elements, change)  # the first frame at a place prepares it
        apart = np.abs(found / model.with_change_on(elements, change).voltages() - 1).max()

        def updated(elements: NDArray[np.int64] = elements, change: Array = change) -> Array:
            return local.voltages(elements, change)

        def again(elements: NDArray[np.int64] = elements, change: Array = change) -> Array:
            return model.with_change_on(elements, change).voltages()

        yield ratio_row(
            compare(
                f"one frame, {count} of nine places pressed, {len(mesh.elements)} elements; alike to {apart:.0e}",
                ("local update", updated),
                ("factorising again", again),
                repeats=_REPEATS,
                burst=5,
            ),
            goal,
        )


def _cost_of_accuracy() -> Iterator[str]:
    yield "\nWhat accuracy costs: time to assemble, factorise and solve 16 drives on a prepared disc, arcs, z = 0.05."
    yield "\n| order | elements | unknowns | error, 208 used | error, all | error with the inclusion | time |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for order, sizes in ((1, (0.12, 0.06, 0.04, 0.028)), (2, (0.2, 0.15, 0.12, 0.1, 0.08))):
        for size in sizes:
            model = _arc_model(order, size)
            used, every = _errors(_unloaded(model)(), model.readings(_exact(0.0)))
            included, _ = _errors(_included(model)(), model.readings(_exact(0.5)))
            seconds = fastest(_unloaded(model), _REPEATS)
            yield (
                f"| {order} | {len(model.mesh.elements)} | {model.elements.count} | {used:.1e} | {every:.1e}"
                f" | {included:.1e} | {shown(seconds)} |"
            )


def _orders() -> Iterator[str]:
    yield "Orders of convergence in the element size, all readings, from sizes of 0.056 to 0.028 radii (first order)"
    yield "and 0.12 to 0.07 (second)."
    yield "\n| z | first order | second order |"
    yield "| --- | --- | --- |"
    families = {1: (0.056, 0.04, 0.028), 2: (0.12, 0.09, 0.07)}
    for contact in (1e-3, 1e-2, 0.05, 0.1, 1.0):
        found = []
        for order, sizes in families.items():
            models = [_arc_model(order, size).with_values(contact_impedance=np.full(16, contact)) for size in sizes]
            exact = models[0].readings(_exact(0.0, contact))
            found.append(convergence_order([_errors(model.voltages(), exact)[1] for model in models], sizes))
        yield f"| {contact:g} | {found[0]:.1f} | {found[1]:.1f} |"


def _loads() -> Iterator[str]:
    """Signal of a 13 mm head, against the exact one without a mesh."""
    yield "Signal of a 13 mm head at the nine places, γ +50 %, on the 100 mm disc with pins, against the solution by"
    yield "multipoles: relative error of the change of the 208 readings (mean; worst place)."
    yield "\n| order | elements | scaled by the covered share | stacked layers | full solve | local update |"
    yield "| --- | --- | --- | --- | --- | --- |"
    sensor = load_sensor_type("disc-100mm").value
    exact_model = RoundLoadModel(PinnedDisc(sensor.radius_mm, sensor.electrodes, 0.2), sensor.pattern)
    for order, size in ((1, 3.0), (1, 2.25), (2, 12.0), (2, 8.0), (2, 5.0)):
        mesh = sheet_mesh(sensor, size_mm=size, order=order)
        model = ForwardModel(mesh, sensor.pattern, np.ones(len(mesh.elements)), np.full(16, 0.2), order=order)
        local = LocalUpdate(model)
        errors = np.array([_load_errors(local, exact_model, place) for place in NINE_LOCATIONS_MM])
        load = cover(model.elements, RoundFootprint(*NINE_LOCATIONS_MM[3], 6.5))
        change = load.change(model.conductance, 0.5)
        (mean, other), (worst, last) = errors.mean(axis=0), errors.max(axis=0)
        yield (
            f"| {order} | {len(mesh.elements)} | {mean:.1e}; {worst:.1e} | {other:.1e}; {last:.1e}"
            f" | {shown(fastest(_unloaded(model), _REPEATS))}"
            f" | {shown(fastest(lambda local=local, load=load, c=change: local.voltages(load.elements, c), 50))} |"
        )


def _load_errors(local: LocalUpdate, exact_model: RoundLoadModel, place: tuple[float, float]) -> list[float]:
    model = local.model
    loads = RoundLoads.from_contrast(np.array([place]), np.array([6.5]), np.array([0.5]))
    exact = exact_model.readings(loads).change[0][_USED]
    load = cover(model.elements, RoundFootprint(*place, 6.5))
    changes = (0.5 * load.share, load.change(model.conductance, 0.5))
    found = [(local.voltages(load.elements, change) - model.voltages())[_USED] for change in changes]
    return [float(np.linalg.norm(each - exact) / np.linalg.norm(exact)) for each in found]


@lru_cache(maxsize=32)
def _arc_model(order: int, size: float) -> ForwardModel:
    mesh = sheet_mesh(_ARCS, size_mm=size, order=order)
    return ForwardModel(mesh, _ARCS.pattern, np.ones(len(mesh.elements)), np.full(16, _CONTACT), order=order)


def _unloaded(model: ForwardModel) -> Callable[[], Array]:
    return lambda: model.with_values().voltages()


def _included(model: ForwardModel) -> Callable[[], Array]:
    def solve() -> Array:
        load = cover(model.elements, RoundFootprint(0.0, 0.0, 0.5))
        return model.with_change_on(load.elements, load.change(model.conductance, 2.0)).voltages()

    return solve


@lru_cache(maxsize=16)
def _exact(inclusion: float, contact: float = _CONTACT) -> Array:
    sheet = ConcentricSheet(1.0, 1.0, inclusion, 3.0)
    return arc_transfer_impedance(sheet, _ARCS.electrodes.angles_rad(), 0.05, contact, modes=30, harmonics=60_000)


def _errors(found: Array, exact: Array) -> tuple[float, float]:
    """Of the readings that touch no driven electrode, and of all."""
    norm = np.linalg.norm
    used = norm((found - exact)[_USED]) / norm(exact[_USED])
    return float(used), float(norm(found - exact) / norm(exact))


def _largest_difference(model: ForwardModel, other: Peer) -> float:
    """Of our readings from pyEIT's on its own mesh, relative to the largest."""
    theirs = np.abs(other.readings()).ravel()
    ours = np.abs(model.voltages()[_USED])
    return float(np.abs(np.sort(ours) - np.sort(theirs)).max() / theirs.max())
