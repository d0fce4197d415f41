"""Hard cases of loads on a sheet: local updates without refactorising, and exact limits."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.forward.coverage import disc_coverage
from cbsr_qa.eit.forward.model import point_model
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.cases.forward import FIFTY, compare_fifty_digits
from cbsr_qa.studies.hard_cases.sheets import (
    inclusion,
    islands,
    reading_condition,
    relative_error,
    small_model,
)

AREA: Final = Area("forward model")


def _under_a_head() -> NDArray[np.int64]:
    """Elements with their centres within 12 mm of a place beside the middle."""
    away = np.hypot(*(small_model().mesh.centroids_mm - (12.0, 5.0)).T)
    return np.flatnonzero(away < 12.0).astype(np.int64)


def compare_load(before: Array, factor: float) -> Answer:
    """A load that leaves a factor of the sheet's conductances (e,) [S], by local update, against fifty digits."""
    model, elements = small_model().with_values(conductance=before), _under_a_head()
    change = (factor - 1) * before[elements]
    pressed = model.with_change_on(elements, change)
    return compare_fifty_digits(
        pressed, LocalUpdate(model).voltages(elements, change), condition=reading_condition(pressed, before)
    )


@AREA.against(FIFTY)
def load_of_1e8_by_local_update() -> Answer:
    """A load that conducts a hundred million times better, solved for without factorising the sheet again."""
    return compare_load(inclusion(1.0), 1e8)


@AREA.against(FIFTY)
def load_of_1e_7_by_local_update() -> Answer:
    """A load that leaves a ten millionth of the conductance, stated as its change."""
    return compare_load(inclusion(1.0), 1e-7)


@AREA.against(FIFTY)
def load_where_the_mesh_begins_in_an_insulator() -> Answer:
    """A load on a sheet whose first element is an insulator, at which potentials would be held."""
    conductance = np.ones(len(small_model().mesh.elements))
    conductance[0] = 2e-8
    return compare_load(conductance, 2.0)


@AREA.against(FIFTY)
def load_between_electrodes_parted_by_1e8() -> Answer:
    """A load on a sheet whose electrodes sit on good conductors, parted by one a hundred million times worse."""
    return compare_load(islands(1e-8), 2.0)


@AREA.against(FIFTY)
def load_beside_perfect_contacts() -> Answer:
    """A load on a sheet whose contacts are next to perfect, solved for without factorising it again."""
    elements = _under_a_head()
    model = small_model().with_values(contact_impedance=1e-8 * small_model().prepared.contacts.lengths_mm)
    change = np.ones(len(elements))
    return compare_fifty_digits(model.with_change_on(elements, change), LocalUpdate(model).voltages(elements, change))


@AREA.against(FIFTY)
def loads_a_nanometre_apart() -> Answer:
    """Two simultaneous loads a nanometre apart."""
    model = small_model()
    loads = [disc_coverage(model.mesh, x, -3.0, 9.0) for x in (8.0, 8.0 + 1e-6)]
    elements = np.concatenate([covered for covered, _ in loads])
    change = np.concatenate([0.5 * share for _, share in loads])
    return compare_fifty_digits(model.with_change_on(elements, change), LocalUpdate(model).voltages(elements, change))


@AREA.against(FIFTY)
def contacts_become_1e7_poorer() -> Answer:
    """All contacts fail between two frames: their impedance rises ten million times."""
    model = small_model()
    impedance = 1e7 * model.prepared.contacts.lengths_mm
    computed = LocalUpdate(model).voltages(np.zeros(0, dtype=np.int64), np.zeros(0), impedance)
    return compare_fifty_digits(model.with_values(contact_impedance=impedance), computed)


@AREA.against("the readings of the sheet before")
def load_of_1e6_taken_off_again() -> Answer:
    """A contrast of a million is put on and taken off."""
    model, elements = small_model(), _under_a_head()
    change = np.full(len(elements), 1e6)
    pressed = model.with_change_on(elements, change)
    released = LocalUpdate(pressed).voltages(elements, -change)
    error = relative_error(released, model.voltages(), model.pattern)
    return answer_from_condition(error, reading_condition(model, pressed.conductance))


@AREA.against("V(c γ) = V/c, exactly")
def point_electrodes_in_other_units() -> Answer:
    """Point electrodes, a contrast of 1e8, and conductances in microsiemens."""
    model = small_model()
    nodes = np.array([edges[0, 0] for edges in model.mesh.electrode_edges])
    conductance = inclusion(1e8)
    points = point_model(model.mesh, nodes, model.pattern, conductance)
    scaled = point_model(model.mesh, nodes, model.pattern, 1e-6 * conductance)
    is_usable = model.pattern.usable()
    felt = np.linalg.norm(np.abs(points.jacobian()[is_usable]) @ conductance)
    condition = float(felt / np.linalg.norm(points.voltages()[is_usable]))
    error = relative_error(1e-6 * scaled.voltages(), points.voltages(), model.pattern)
    return answer_from_condition(error, condition)


@AREA.refuses(NumericsError, "the refusal, by the element")
def load_that_leaves_nothing() -> None:
    """A load that removes all conductance."""
    elements = _under_a_head()
    LocalUpdate(small_model()).voltages(elements, -np.ones(len(elements)))
