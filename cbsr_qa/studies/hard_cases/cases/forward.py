"""Hard cases of the forward model: contrasts, contacts, slivers and units, against fifty-digit solutions."""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain import NumericsError, RefusedError
from cbsr_qa.domain.sensor import Mesh
from cbsr_qa.eit.forward import REFINED_ABOVE, UNREFINED_ERROR, ForwardModel, ValueRangeError
from cbsr_qa.studies.hard_cases.case import Answer, HardCase, conditioned_bound
from cbsr_qa.studies.hard_cases.cases import forward_exact, forward_loads
from cbsr_qa.studies.hard_cases.sheets import (
    ELECTRODES,
    RADIUS_MM,
    exact_derivatives,
    exact_readings,
    inclusion,
    islands,
    reading_condition,
    relative_error,
    scattered,
    small_mesh,
    small_model,
)

Array = NDArray[np.float64]

_AREA: Final = "forward model"
_FIFTY: Final = "the same equations in fifty digits, in their textbook form"
_USUAL_MM: Final = 5.0


def readings_of(conductance: Callable[[], Array] | None = None, ratio: float | None = None) -> Answer:
    """Readings of the small sheet against fifty digits.

    Parameters
    ----------
    conductance : gives (e,) [S]; None for 1 S everywhere.
    ratio : z γ/|E| of every electrode for γ = 1 S; None for ordinary contacts.
    """
    lengths = small_model().prepared.contacts.lengths_mm
    impedance = np.full(ELECTRODES, _USUAL_MM) if ratio is None else ratio * lengths
    values = inclusion(1.0) if conductance is None else conductance()
    return against_fifty_digits(small_model().changed(conductance=values, contact_impedance=impedance))


def against_fifty_digits(model: ForwardModel, condition: float | None = None) -> Answer:
    """Readings of a model of the first order against fifty digits; its own condition number unless one is given."""
    exact = exact_readings(model.mesh, model.pattern, model.conductance, model.contact_impedance)
    condition = reading_condition(model) if condition is None else condition
    error = relative_error(model.voltages(), exact, model.pattern)
    return Answer(error, conditioned_bound(condition), condition)


def _sliver() -> Answer:
    """Two rings a millionth of the radius apart; the condition number is of the places, a corner over a height."""
    gap = 1e-6 * RADIUS_MM
    mesh = small_mesh(np.array([10.0, 20.0, 20.0 + gap, 35.0, RADIUS_MM]))
    model = ForwardModel(mesh, small_model().pattern, np.ones(len(mesh.elements)), np.full(ELECTRODES, _USUAL_MM))
    longest = np.hypot(*np.diff(mesh.corners_mm[:, [0, 1, 2, 0]], axis=1).transpose(2, 0, 1)).max(axis=1)
    condition = float((longest * np.abs(mesh.corners_mm).max(axis=(1, 2)) / mesh.areas_mm2).max())
    return against_fifty_digits(model, condition)


def _flat() -> Answer:
    gap = 1e-17 * RADIUS_MM  # below a rounding of the places
    small_mesh(np.array([10.0, 20.0, 20.0 + gap, 35.0, RADIUS_MM]))
    return Answer(0.0, 0.0)


def _in_other_units(length: float, conductance: float) -> Answer:
    """V(s x, c γ, s z/c) = V/c: the same sheet in units in which its numbers are tiny or huge."""
    usual = small_model()
    mesh = Mesh(length * usual.mesh.nodes_mm, usual.mesh.elements, usual.mesh.electrode_edges)
    model = ForwardModel(
        mesh, usual.pattern, conductance * usual.conductance, length / conductance * usual.contact_impedance
    )
    error = relative_error(conductance * model.voltages(), usual.voltages(), usual.pattern)
    condition = reading_condition(model)
    return Answer(error, conditioned_bound(condition), condition)


def _reciprocal() -> Answer:
    """V_kl = V_lk with all difficulties combined."""
    lengths = small_model().prepared.contacts.lengths_mm
    contacts = lengths * np.geomspace(1e-4, 1e4, ELECTRODES)
    model = small_model().changed(conductance=scattered(5.0), contact_impedance=contacts)
    readings = model.voltages()
    used = model.pattern.usable()
    condition = reading_condition(model)
    error = float(np.linalg.norm((readings - readings.T)[used]) / np.linalg.norm(readings[used]))
    return Answer(error, conditioned_bound(condition), condition)


def _homogeneous() -> Answer:
    """Σ γ ∂V/∂γ − Σ z ∂V/∂z = −V, because V(cγ, z/c) = V/c (Euler): the adjoint fields against the voltages."""
    model = small_model().changed(conductance=scattered(8.0))
    used = model.pattern.usable()
    voltages = model.voltages()[used]
    whole = model.jacobian()[used] @ model.conductance - model.contact_jacobian()[used] @ model.contact_impedance
    condition = reading_condition(model)
    error = float(np.linalg.norm(whole + voltages) / np.linalg.norm(voltages))
    return Answer(error, conditioned_bound(condition), condition)


def _sensitivities(conductance: Callable[[], Array], ratio: float, of_contacts: bool) -> Answer:
    """Worst column of the Jacobian, of elements or of contacts, against fifty digits; two fields make a column."""
    contacts = ratio * small_model().prepared.contacts.lengths_mm
    model = small_model().changed(conductance=conductance(), contact_impedance=contacts)
    used = model.pattern.usable()
    exact = exact_derivatives(model.mesh, model.pattern, model.conductance, contacts)[int(of_contacts)][used]
    found = model.contact_jacobian()[used] * contacts if of_contacts else model.jacobian()[used] * model.conductance
    error = float((np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0)).max())
    condition = 2 * reading_condition(model)
    bound = conditioned_bound(condition, _leak(model.conductance, model.prepared.contacts.lengths_mm / contacts))
    return Answer(error, bound, condition, note="the worst of all columns")


def _leak(conductance: Array, contacts: Array) -> float:
    """What potentials that are not refined lose within good conductors, where fields are faint; else nothing."""
    apart = float(max(conductance.max(), contacts.max()) / conductance.min())
    return UNREFINED_ERROR * apart if apart <= REFINED_ABOVE else 0.0


def _case(name: str, hard: str, run: Callable[[], Answer], truth: str = _FIFTY) -> HardCase:
    return HardCase(name, _AREA, hard, truth, run)


_CONTRASTS: Final = (
    _case(
        "inclusion-conducts-1e8-better",
        "A load that conducts a hundred million times better than the sheet round it.",
        partial(readings_of, partial(inclusion, 1e8)),
    ),
    _case(
        "inclusion-conducts-1e4-better",
        "A load that conducts ten thousand times better than the sheet round it.",
        partial(readings_of, partial(inclusion, 1e4)),
    ),
    _case(
        "inclusion-conducts-1e4-worse",
        "A load that conducts ten thousand times worse than the sheet round it.",
        partial(readings_of, partial(inclusion, 1e-4)),
    ),
    _case(
        "inclusion-conducts-1e8-worse",
        "A tear in the sheet: a hundred millionth of its conductance is left.",
        partial(readings_of, partial(inclusion, 1e-8)),
    ),
    _case(
        "electrodes-parted-by-1e8",
        "Good conductors round the electrodes, parted by one a hundred million times worse that all current passes.",
        partial(readings_of, partial(islands, 1e-8)),
    ),
    _case(
        "conductance-scattered-over-8-decades",
        "Every element of the mesh has a conductance of its own, over eight decades.",
        partial(readings_of, partial(scattered, 8.0)),
    ),
)

_CONTACTS: Final = (
    _case(
        "contacts-next-to-perfect",
        "Contact impedance a thousand millionth of what the sheet next to it has: the equations divide by it.",
        partial(readings_of, ratio=1.001e-9),
    ),
    _case(
        "contacts-next-to-open",
        "Contact impedance a thousand million times what the sheet has: driven contacts drop nearly all the voltage.",
        partial(readings_of, ratio=0.999e9),
    ),
)

_GEOMETRY: Final = (
    _case("slivers-of-a-millionth", "A ring of triangles a million times as long as they are high.", _sliver),
    _case(
        "sheet-of-a-nanometre",
        "Lengths of 1e-8 mm: areas of 1e-16 mm², as if metres were taken for millimetres three times.",
        partial(_in_other_units, 1e-8, 1.0),
        "V(s x, γ, s z) = V, the same sheet in millimetres",
    ),
    _case(
        "sheet-of-ten-kilometres",
        "Lengths of 1e7 mm.",
        partial(_in_other_units, 2e5, 1.0),
        "V(s x, γ, s z) = V, the same sheet in millimetres",
    ),
    _case(
        "conductance-of-1e-14-siemens",
        "A sheet that hardly conducts: only absolute values are extreme, not ratios.",
        partial(_in_other_units, 1.0, 1e-14),
        "V(c γ, z/c) = V/c, the same sheet at 1 S",
    ),
    _case(
        "conductance-of-1e14-siemens",
        "A sheet with a conductance beyond any material's.",
        partial(_in_other_units, 1.0, 1e14),
        "V(c γ, z/c) = V/c, the same sheet at 1 S",
    ),
    _case(
        "reciprocity-when-all-is-hard",
        "Conductances over five decades and contacts over eight, at once.",
        _reciprocal,
        "V_kl = V_lk, exactly",
    ),
    _case(
        "sensitivity-within-good-conductors",
        "Sensitivities of elements within good conductors, where potentials differ in the ninth digit only.",
        partial(_sensitivities, partial(islands, 1e-8), 1.0, False),
    ),
    _case(
        "sensitivity-to-perfect-contacts",
        "Sensitivities to contacts of a thousand millionth of the sheet, under which potentials hardly differ.",
        partial(_sensitivities, partial(inclusion, 1.0), 1.001e-9, True),
    ),
    _case(
        "derivatives-over-8-decades",
        "Sensitivities of elements whose conductances lie eight decades apart.",
        _homogeneous,
        "Σ γ ∂V/∂γ − Σ z ∂V/∂z = −V, exactly",
    ),
)

_REFUSED: Final = (
    HardCase(
        "contrast-beyond-1e8",
        _AREA,
        "A contrast of 1e9, as by a typing error in a material.",
        "the refusal, by the elements and their conductances",
        partial(readings_of, partial(inclusion, 1e9)),
        refuses=ValueRangeError,
    ),
    HardCase(
        "contact-without-impedance",
        _AREA,
        "A contact impedance of exactly zero, which the equations divide by.",
        "the refusal, by the electrode",
        partial(readings_of, ratio=0.0),
        refuses=NumericsError,
    ),
    HardCase(
        "contact-open",
        _AREA,
        "A lead has come off: a contact impedance of 1e15 sheets.",
        "the refusal, by the electrode and its ratio",
        partial(readings_of, ratio=1e15),
        refuses=ValueRangeError,
    ),
    HardCase(
        "triangle-without-area",
        _AREA,
        "Two rings of corners closer than their places can be written: triangles without area.",
        "the refusal, by the element",
        _flat,
        refuses=RefusedError,
    ),
)

CASES: Final[tuple[HardCase, ...]] = (
    *_CONTRASTS,
    *_CONTACTS,
    *forward_exact.CASES,
    *_GEOMETRY,
    *forward_loads.CASES,
    *_REFUSED,
)
