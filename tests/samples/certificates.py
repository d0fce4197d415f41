"""A certificate with budgets made by hand, and the laboratory that issues it."""

from dataclasses import replace
from datetime import UTC, date, datetime
from math import inf

from stored_runs import identity

from cbsr_qa.domain.plan.plan import CertificateSettings
from cbsr_qa.domain.plan.standards import ReferenceStandard, StandardRole
from cbsr_qa.domain.results.certificate import Certificate, CheckedLoad, Customer, LeftOutLoad, Replacement
from cbsr_qa.domain.results.expanded_force import Budget, BudgetComponent, ExpandedForce
from cbsr_qa.stats.conformity import decide_error

LABORATORY = {
    "laboratory": "Soft Sensor Works",
    "prefix": "SSW",
    "street": "Werkstraße 5",
    "post_code": "38116",
    "city": "Braunschweig",
    "country": "DE",
    "place": "Hall 3, line 1",
    "performed_at": "laboratory",
    "signatory": "Ada Otani",
    "function": "head of the laboratory",
}
JUDGED = {"max_error_N": 0.2, "max_error_percent": 5.0, "decision": "guarded"}
CELL = ReferenceStandard("load_cell", "K-7", "D-K-1", "2026-03-31", "2027-03-31", 0.2, 2.0, "%")
#: What an attacker, or a careless customer, may call himself.
HOSTILE = "Müller & <b>Sons</b> ]]> <!-- \"'"


def laboratory_table(**changes):
    """Return the table ``[certificate]`` of a file."""
    values = LABORATORY | {"validity_months": 12} | JUDGED | changes
    lines = [f"{name} = {value!r}".replace("'", '"') for name, value in values.items()]
    return "\n".join(["[certificate]", *lines, ""])


def settings(**changes):
    """Return what the laboratory states."""
    return CertificateSettings(**(LABORATORY | {"validity_months": 12} | JUDGED | changes))


def expanded_force(place_mm=(0.0, 0.0), force_N=2.0, u_N=0.05, dof=23.7, k=2.069, not_stated=(), name="load cell"):
    """Return a force with a budget of one component."""
    component = BudgetComponent(name, "B", u_N, dof, 1.0, "certificate K-7", shared=True)
    return ExpandedForce(place_mm, force_N, 55.0, Budget(u_N, dof, k, (component,), tuple(not_stated)))


def checked_load(error_N=0.03, force_N=2.0, *, stated=None, **budget):
    """Return a held-out load, judged by the laboratory's requirement."""
    stated = stated or settings()
    expanded = expanded_force((12.5, -3.0), force_N, **budget)
    if not stated.judges:
        return CheckedLoad("random loads", force_N, force_N + error_N, expanded)
    guard = expanded.U_N if stated.decision == "guarded" else 0.0
    maximum_N = stated.max_error_of(force_N)
    found = decide_error(error_N, maximum_N, guard, expanded.standard_uncertainty_N, expanded.dof)
    judged = maximum_N, str(found.outcome), found.conformance
    return CheckedLoad("random loads", force_N, force_N + error_N, expanded, *judged)


def certificate(**changes):
    """Return a certificate of a sensor of a real bench; fields may be changed."""
    places = [(0.0, 0.0), (30.0, 0.0), (-15.0, 15.0)]
    values = {
        "number": "SSW-01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d",
        "issued_at": datetime(2026, 11, 22, 9, 30, tzinfo=UTC),
        "settings": settings(),
        "customer": Customer("Robots plc", "Ring 1, 10115 Berlin"),
        "identity": replace(identity("01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d"), simulated=()),
        "calibration": "01989c3e-7000-7a42-b6d0-0e6f5a1f2c3d",
        "calibration_digest": 64 * "c",
        "performed": (date(2026, 11, 21), date(2026, 11, 21)),
        "recipe_digest": 64 * "d",
        "verdict": "pass",
        "sensor": "disc-100mm, 16 electrodes",
        "head": "13 mm diameter",
        "temperature_C": (22.4, 23.1),
        "range_N": (1.4, 4.1),
        "radius_mm": 39.9,
        "standards": (CELL,),
        "forces": tuple(
            expanded_force(place, force_N, 0.03 + 0.01 * force_N, inf if force_N == 1.4 else 23.7)
            for place in places
            for force_N in (1.4, 2.75, 4.1)
        ),
        "forces_in_use": tuple(
            expanded_force(place, force_N, 0.04 + 0.01 * force_N, not_stated=("ageing of the sensor",))
            for place in places
            for force_N in (1.4, 2.75, 4.1)
        ),
        "checked": (checked_load(0.03), checked_load(-0.05, 3.5)),
        "left_out": (),
        "deviations": (),
        "reduced": ("all loads were pressed at one strain",),
        "valid_until": date(2027, 11, 21),
        "replaced": None,
    }
    return Certificate(**(values | changes))


def largest_certificate():
    """Return a certificate with as much text as the page must hold: nine places, many loads, long names."""
    places = [(float(x), float(y)) for x in (-30, 0, 30) for y in (-30, 0, 30)]
    forces = [
        expanded_force(place, force_N, not_stated=[f"an input of the budget, number {n}" for n in range(8)])
        for place in places
        for force_N in (1.4, 2.75, 4.1)
    ]
    simulated = tuple(f"instrument {n}: simulated, scene base, seed 743501276" for n in range(3))
    return certificate(
        settings=settings(laboratory="W" * 60, street="S" * 60, city="C" * 40, place="P" * 80, email="e" * 60),
        customer=Customer(f"{'Company ' * 14}X", f"{'Street ' * 16}Y"),
        standards=tuple(replace(CELL, role=str(role), laboratory="L" * 80) for role in StandardRole),
        replaced=Replacement(
            "SSW-01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d-R1", "a reason in a sentence or two, " * 8, 64 * "e"
        ),
        identity=replace(
            certificate().identity, simulated=simulated, instruments=4 * certificate().identity.instruments
        ),
        forces=tuple(forces),
        forces_in_use=tuple(forces),
        left_out=tuple(
            LeftOutLoad("random loads", (30.0, 0.0), why, 5.2, 4.9) for why in ("", "no force was recorded")
        ),
        checked=tuple(checked_load(0.02 * n, 1.5 + 0.1 * n) for n in range(25)),
        deviations=tuple(f"gate, disk: finding number {n}; overridden by Ada: {'a reason ' * 20}" for n in range(9)),
        reduced=tuple(
            f"reason number {n} why the range is smaller than the recipe intended, in words" for n in range(9)
        ),
    )
