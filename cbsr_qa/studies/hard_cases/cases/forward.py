"""Hard cases of the forward model: contrasts, contacts, slivers and units, against fifty-digit solutions."""

from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.forward.value_range import REFINED_ABOVE, UNREFINED_ERROR, ValueRangeError
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition, condition_bound
from cbsr_qa.studies.hard_cases.exact import relative_difference
from cbsr_qa.studies.hard_cases.sheets import (
    ELECTRODES,
    RADIUS_MM,
    exact_derivatives,
    exact_readings,
    inclusion,
    islands,
    reading_condition,
    relative_error,
    scatter_conductance,
    small_mesh,
    small_model,
)

AREA: Final = Area("forward model")
FIFTY: Final = "the same equations in fifty digits, in their textbook form"
_LENGTHS: Final = "V(s x, γ, s z) = V, the same sheet in millimetres"
_CONDUCTANCES: Final = "V(c γ, z/c) = V/c, the same sheet at 1 S"
_USUAL_MM: Final = 5.0


def readings_of(conductance: Array | None = None, ratio: float | None = None) -> Answer:
    """Readings of the small sheet against fifty digits.

    Parameters
    ----------
    conductance : (e,) [S]; None for 1 S everywhere.
    ratio : z γ/|E| of every electrode for γ = 1 S; None for ordinary contacts.
    """
    lengths = small_model().prepared.contacts.lengths_mm
    impedance = np.full(ELECTRODES, _USUAL_MM) if ratio is None else ratio * lengths
    values = inclusion(1.0) if conductance is None else conductance
    return compare_fifty_digits(small_model().with_values(conductance=values, contact_impedance=impedance))


def compare_fifty_digits(
    model: ForwardModel, computed: Array | None = None, *, condition: float | None = None
) -> Answer:
    """Readings of a model of the first order, or others (drives, measures) in their place, against fifty digits.

    Their condition number is, by default, that for small changes of conductances and contacts.
    """
    exact = exact_readings(model.mesh, model.pattern, model.conductance, model.contact_impedance)
    error = relative_error(model.voltages() if computed is None else computed, exact, model.pattern)
    return answer_from_condition(error, reading_condition(model) if condition is None else condition)


def _change_units(length: float, conductance: float) -> Answer:
    """V(s x, c γ, s z/c) = V/c: the same sheet in units in which its numbers are tiny or huge."""
    usual = small_model()
    mesh = Mesh(length * usual.mesh.nodes_mm, usual.mesh.elements, usual.mesh.electrode_edges)
    model = ForwardModel(
        mesh, usual.pattern, conductance * usual.conductance, length / conductance * usual.contact_impedance
    )
    error = relative_error(conductance * model.voltages(), usual.voltages(), usual.pattern)
    return answer_from_condition(error, reading_condition(model))


def _sensitivities(conductance: Array, ratio: float, of_contacts: bool) -> Answer:
    """Worst column of the Jacobian, of elements or of contacts, against fifty digits; two fields make a column."""
    contacts = ratio * small_model().prepared.contacts.lengths_mm
    model = small_model().with_values(conductance=conductance, contact_impedance=contacts)
    is_usable = model.pattern.usable()
    exact = exact_derivatives(model.mesh, model.pattern, model.conductance, contacts)[int(of_contacts)][is_usable]
    computed = (
        model.contact_jacobian()[is_usable] * contacts
        if of_contacts
        else model.jacobian()[is_usable] * model.conductance
    )
    error = float((np.linalg.norm(computed - exact, axis=0) / np.linalg.norm(exact, axis=0)).max())
    condition = 2 * reading_condition(model)
    # Error of unrefined potentials within good conductors, where fields are faint; zero for refined ones.
    conductance_ratio = float(
        max(model.conductance.max(), (model.prepared.contacts.lengths_mm / contacts).max()) / model.conductance.min()
    )
    leak = UNREFINED_ERROR * conductance_ratio if conductance_ratio <= REFINED_ABOVE else 0.0
    bound = condition_bound(condition, leak)
    return Answer(error, bound, condition, note="the worst of all columns")


@AREA.against(FIFTY)
def inclusion_conducts_1e8_better() -> Answer:
    """A load that conducts a hundred million times better than the sheet round it."""
    return readings_of(inclusion(1e8))


@AREA.against(FIFTY)
def inclusion_conducts_1e4_better() -> Answer:
    """A load that conducts ten thousand times better than the sheet round it."""
    return readings_of(inclusion(1e4))


@AREA.against(FIFTY)
def inclusion_conducts_1e4_worse() -> Answer:
    """A load that conducts ten thousand times worse than the sheet round it."""
    return readings_of(inclusion(1e-4))


@AREA.against(FIFTY)
def inclusion_conducts_1e8_worse() -> Answer:
    """A tear in the sheet: a hundred millionth of its conductance is left."""
    return readings_of(inclusion(1e-8))


@AREA.against(FIFTY)
def electrodes_parted_by_1e8() -> Answer:
    """Good conductors round the electrodes, parted by one a hundred million times worse that all current passes."""
    return readings_of(islands(1e-8))


@AREA.against(FIFTY)
def conductance_scattered_over_8_decades() -> Answer:
    """Every element of the mesh has a conductance of its own, over eight decades."""
    return readings_of(scatter_conductance(8.0))


@AREA.against(FIFTY)
def contacts_next_to_perfect() -> Answer:
    """Contact impedance a thousand millionth of what the sheet next to it has: the equations divide by it."""
    return readings_of(ratio=1.001e-9)


@AREA.against(FIFTY)
def contacts_next_to_open() -> Answer:
    """Contact impedance a thousand million times what the sheet has: driven contacts drop nearly all the voltage."""
    return readings_of(ratio=0.999e9)


@AREA.against(FIFTY)
def slivers_of_a_millionth() -> Answer:
    """A ring of triangles a million times as long as they are high."""
    gap = 1e-6 * RADIUS_MM
    mesh = small_mesh(np.array([10.0, 20.0, 20.0 + gap, 35.0, RADIUS_MM]))
    model = ForwardModel(mesh, small_model().pattern, np.ones(len(mesh.elements)), np.full(ELECTRODES, _USUAL_MM))
    longest = np.hypot(*np.diff(mesh.corners_mm[:, [0, 1, 2, 0]], axis=1).transpose(2, 0, 1)).max(axis=1)
    condition = float((longest * np.abs(mesh.corners_mm).max(axis=(1, 2)) / mesh.areas_mm2).max())
    return compare_fifty_digits(model, condition=condition)


@AREA.against(_LENGTHS)
def sheet_of_a_nanometre() -> Answer:
    """Lengths of 1e-8 mm: areas of 1e-16 mm², as if metres were taken for millimetres three times."""
    return _change_units(1e-8, 1.0)


@AREA.against(_LENGTHS)
def sheet_of_ten_kilometres() -> Answer:
    """Lengths of 1e7 mm."""
    return _change_units(2e5, 1.0)


@AREA.against(_CONDUCTANCES)
def conductance_of_1e_14_siemens() -> Answer:
    """A sheet that hardly conducts: only absolute values are extreme, not ratios."""
    return _change_units(1.0, 1e-14)


@AREA.against(_CONDUCTANCES)
def conductance_of_1e14_siemens() -> Answer:
    """A sheet with a conductance beyond any material's."""
    return _change_units(1.0, 1e14)


@AREA.against("V_kl = V_lk, exactly")
def reciprocity_when_all_is_hard() -> Answer:
    """Conductances over five decades and contacts over eight, at once."""
    lengths = small_model().prepared.contacts.lengths_mm
    contacts = lengths * np.geomspace(1e-4, 1e4, ELECTRODES)
    model = small_model().with_values(conductance=scatter_conductance(5.0), contact_impedance=contacts)
    readings = model.voltages()
    return answer_from_condition(relative_error(readings.T, readings, model.pattern), reading_condition(model))


@AREA.against(FIFTY)
def sensitivity_within_good_conductors() -> Answer:
    """Sensitivities of elements within good conductors, where potentials differ in the ninth digit only."""
    return _sensitivities(islands(1e-8), 1.0, False)


@AREA.against(FIFTY)
def sensitivity_to_perfect_contacts() -> Answer:
    """Sensitivities to contacts of a thousand millionth of the sheet, under which potentials hardly differ."""
    return _sensitivities(inclusion(1.0), 1.001e-9, True)


@AREA.against("Σ γ ∂V/∂γ − Σ z ∂V/∂z = −V, exactly")
def derivatives_over_8_decades() -> Answer:
    """Sensitivities of elements whose conductances lie eight decades apart."""
    model = small_model().with_values(conductance=scatter_conductance(8.0))
    is_usable = model.pattern.usable()
    voltages = model.voltages()[is_usable]
    summed = (
        model.jacobian()[is_usable] @ model.conductance
        - model.contact_jacobian()[is_usable] @ model.contact_impedance
    )
    return answer_from_condition(relative_difference(-summed, voltages), reading_condition(model))


@AREA.refuses(ValueRangeError, "the refusal, by the elements and their conductances")
def contrast_beyond_1e8() -> None:
    """A contrast of 1e9, as by a typing error in a material."""
    readings_of(inclusion(1e9))


@AREA.refuses(NumericsError, "the refusal, by the electrode")
def contact_without_impedance() -> None:
    """A contact impedance of exactly zero, which the equations divide by."""
    readings_of(ratio=0.0)


@AREA.refuses(ValueRangeError, "the refusal, by the electrode and its ratio")
def contact_open() -> None:
    """A lead has come off: a contact impedance of 1e15 sheets."""
    readings_of(ratio=1e15)


@AREA.refuses(RefusedError, "the refusal, by the element")
def triangle_without_area() -> None:
    """Two rings of corners closer than their places can be written: triangles without area."""
    gap = 1e-17 * RADIUS_MM  # below a rounding of the places
    small_mesh(np.array([10.0, 20.0, 20.0 + gap, 35.0, RADIUS_MM]))
