"""Hard cases of loads on a sheet: local updates without refactorising, and exact limits."""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain import NumericsError
from cbsr_qa.eit.forward import LocalUpdate, disc_coverage, point_model
from cbsr_qa.studies.hard_cases.case import Answer, HardCase, conditioned_bound
from cbsr_qa.studies.hard_cases.sheets import (
    exact_readings,
    inclusion,
    islands,
    reading_condition,
    relative_error,
    small_model,
)

Array = NDArray[np.float64]

_AREA: Final = "forward model"
_FIFTY: Final = "the same equations in fifty digits, in their textbook form"


def _under(x_mm: float, y_mm: float, radius_mm: float) -> NDArray[np.int64]:
    away = np.hypot(*(small_model().mesh.centroids_mm - (x_mm, y_mm)).T)
    return np.flatnonzero(away < radius_mm).astype(np.int64)


def loaded(before: Callable[[], Array], factor: float) -> Answer:
    """A load that changes conductance by a factor, by local update, against fifty digits.

    Parameters
    ----------
    before : gives the sheet's conductances (e,) [S].
    factor : what the load leaves of them.
    """
    model = small_model().changed(conductance=before())
    elements = _under(12.0, 5.0, 12.0)
    change = (factor - 1) * model.conductance[elements]
    found = LocalUpdate(model).voltages(elements, change)
    conductance = model.conductance.copy()
    conductance[elements] += change
    exact = exact_readings(model.mesh, model.pattern, conductance, model.contact_impedance)
    condition = reading_condition(model.changed(conductance=conductance), model.conductance)
    return Answer(relative_error(found, exact, model.pattern), conditioned_bound(condition), condition)


def _poor_ground() -> Array:
    """A sheet whose mesh begins in a poor conductor, where a fixed potential would swamp the inverse."""
    conductance = np.ones(len(small_model().mesh.elements))
    conductance[0] = 2e-8
    return conductance


def _coincident() -> Answer:
    """Two simultaneous loads a nanometre apart: nearly equal columns in their coupling matrix."""
    model = small_model()
    loads = [disc_coverage(model.mesh, x, -3.0, 9.0) for x in (8.0, 8.0 + 1e-6)]
    elements = np.concatenate([covered for covered, _ in loads])
    change = np.concatenate([0.5 * share for _, share in loads])
    found = LocalUpdate(model).voltages(elements, change)
    conductance = model.conductance.copy()
    np.add.at(conductance, elements, change)
    exact = exact_readings(model.mesh, model.pattern, conductance, model.contact_impedance)
    condition = reading_condition(model.changed(conductance=conductance))
    return Answer(relative_error(found, exact, model.pattern), conditioned_bound(condition), condition)


def _perfect_contacts() -> Answer:
    """A load on a sheet whose contacts are next to perfect, by local update."""
    lengths = small_model().prepared.contacts.lengths_mm
    model = small_model().changed(contact_impedance=1e-8 * lengths)
    elements = _under(12.0, 5.0, 12.0)
    found = LocalUpdate(model).voltages(elements, np.ones(len(elements)))
    conductance = model.conductance.copy()
    conductance[elements] += 1
    exact = exact_readings(model.mesh, model.pattern, conductance, model.contact_impedance)
    condition = reading_condition(model.changed(conductance=conductance))
    return Answer(relative_error(found, exact, model.pattern), conditioned_bound(condition), condition)


def _contacts_change() -> Answer:
    """Every contact becomes ten million times poorer, by local update."""
    model = small_model()
    lengths = model.prepared.contacts.lengths_mm
    impedance = 1e7 * lengths
    nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
    found = LocalUpdate(model).voltages(*nothing, impedance)
    exact = exact_readings(model.mesh, model.pattern, model.conductance, impedance)
    condition = reading_condition(model.changed(contact_impedance=impedance))
    return Answer(relative_error(found, exact, model.pattern), conditioned_bound(condition), condition)


def _there_and_back() -> Answer:
    """A contrast of 1e6 put on and taken off again, by two local updates."""
    model = small_model()
    elements = _under(12.0, 5.0, 12.0)
    change = np.full(len(elements), 1e6)
    pressed = model.changed_on(elements, change)
    released = LocalUpdate(pressed).voltages(elements, -change)
    error = relative_error(released, model.voltages(), model.pattern)
    condition = reading_condition(model, pressed.conductance)
    return Answer(error, conditioned_bound(condition), condition)


def _vanished() -> Answer:
    elements = _under(12.0, 5.0, 12.0)
    LocalUpdate(small_model()).voltages(elements, -np.ones(len(elements)))
    return Answer(0.0, 0.0)


def _points() -> Answer:
    """Currents into single nodes at a contrast of 1e8, in two units of conductance."""
    model = small_model()
    nodes = np.array([edges[0, 0] for edges in model.mesh.electrode_edges])
    conductance = inclusion(1e8)
    points = point_model(model.mesh, nodes, model.pattern, conductance)
    scaled = point_model(model.mesh, nodes, model.pattern, 1e-6 * conductance)
    condition = float(
        np.linalg.norm(np.abs(points.jacobian()[model.pattern.usable()]) @ conductance)
        / np.linalg.norm(points.voltages()[model.pattern.usable()])
    )
    error = relative_error(1e-6 * scaled.voltages(), points.voltages(), model.pattern)
    return Answer(error, conditioned_bound(condition), condition)


def _case(name: str, hard: str, run: Callable[[], Answer], truth: str = _FIFTY) -> HardCase:
    return HardCase(name, _AREA, hard, truth, run)


CASES: Final[tuple[HardCase, ...]] = (
    _case(
        "load-of-1e8-by-local-update",
        "A load that conducts a hundred million times better, solved for without factorising the sheet again.",
        partial(loaded, partial(inclusion, 1.0), 1e8),
    ),
    _case(
        "load-of-1e-7-by-local-update",
        "A load that leaves a ten millionth of the conductance, stated as its change.",
        partial(loaded, partial(inclusion, 1.0), 1e-7),
    ),
    _case(
        "load-where-the-mesh-begins-in-an-insulator",
        "A load on a sheet whose first element is an insulator, at which potentials would be held.",
        partial(loaded, _poor_ground, 2.0),
    ),
    _case(
        "load-between-electrodes-parted-by-1e8",
        "A load on a sheet whose electrodes sit on good conductors, parted by one a hundred million times worse.",
        partial(loaded, partial(islands, 1e-8), 2.0),
    ),
    _case(
        "load-beside-perfect-contacts",
        "A load on a sheet whose contacts are next to perfect, solved for without factorising it again.",
        _perfect_contacts,
    ),
    _case(
        "loads-a-nanometre-apart",
        "Two simultaneous loads a nanometre apart.",
        _coincident,
    ),
    _case(
        "contacts-become-1e7-poorer",
        "All contacts fail between two frames: their impedance rises ten million times.",
        _contacts_change,
    ),
    _case(
        "load-of-1e6-taken-off-again",
        "A contrast of a million is put on and taken off.",
        _there_and_back,
        "the readings of the sheet before",
    ),
    _case(
        "point-electrodes-in-other-units",
        "Point electrodes, a contrast of 1e8, and conductances in microsiemens.",
        _points,
        "V(c γ) = V/c, exactly",
    ),
    HardCase(
        "load-that-leaves-nothing",
        _AREA,
        "A load that removes all conductance.",
        "the refusal, by the element",
        _vanished,
        refuses=NumericsError,
    ),
)
