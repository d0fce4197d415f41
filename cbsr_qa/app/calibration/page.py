"""The page of ``cbsr-qa calibration show``."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Final

from cbsr_qa.app.calibration.presses_shown import ShownPressCalibration, press_calibration_outcome
from cbsr_qa.app.calibration.shown import Settling, ShownCalibration, ShownExpandedForce
from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.hdf5 import read_in_child, read_issued, verify_calibration_file
from cbsr_qa.domain.plan.standards import PERCENT, StandardRole
from cbsr_qa.domain.results.calibration import BaselineConductance, VerifiedFile
from cbsr_qa.domain.results.press_calibration import PressCalibration
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Page, Paragraph, Section, Table
from cbsr_qa.domain.run.run import run_named
from cbsr_qa.report.tables import format_dof, format_fixed, plural, text_table
from cbsr_qa.store.types import time_of_id

#: Fields with a separate line or table on the page.
_IN_SECTIONS: Final = ("assumed", "baseline_conductance/", "identity/", "settling/", "standards/", "validity/")


def show_calibration(
    path: Path, *, every_field: bool = False
) -> CommandOutcome[ShownCalibration] | CommandOutcome[ShownPressCalibration]:
    """Return the contents of a calibration file. Raise CalibrationError if it is damaged or altered.

    Parameters
    ----------
    every_field : whether the page of a sensor tested on a station lists all fields, not only what the sensor does.
    """
    verified, calibration = read_in_child(path, partial(_verify_and_read, path))
    if isinstance(calibration, PressCalibration):
        return press_calibration_outcome(path, calibration)
    shown = ShownCalibration.from_calibration(path, verified, calibration)
    does = _texts("What it does", iter((*shown.abilities, *_limitations(shown))))
    return CommandOutcome(shown, _page(shown), (does, *(_sections(shown) if every_field else ())))


def _verify_and_read(path: Path) -> tuple[VerifiedFile, Issued]:
    return verify_calibration_file(path), read_issued(path)


def _page(shown: ShownCalibration) -> Page:
    identity = shown.identity
    facts = (
        ("Batch", identity.batch or "not stated"),
        ("Sensor type", identity.sensor_type),
        ("Issued at", identity.issued_at),
        ("Run", run_named(identity.serial, time_of_id(identity.run), identity.run)),
        ("Calibration", identity.calibration),
    )
    banner = Banner("plain", "●", f"Calibration of sensor {identity.serial}", "")
    return Page("Calibration", identity.serial, banner, facts, shown.simulated, printed=(("SHA-256", shown.digest),))


def _sections(shown: ShownCalibration) -> Iterator[Section]:
    yield _texts("Where it may be used", _validity(shown))
    yield Section("Baseline conductance", (_baseline(shown.baseline_conductance),))
    yield _texts("Force", _force(shown))
    title = "Expanded uncertainty of force"
    if shown.no_expanded_forces is None:
        forces = shown.expanded_forces
        worst = max(forces, key=lambda one: one.in_use.U_N)
        yield Section(title, (_tabulate_expanded_forces(forces), _tabulate_components(worst)))
    else:
        yield _texts(title, iter([f"None is stated: {shown.no_expanded_forces}."]))
    yield Section("Settling", (_settling(shown.settling),))
    other_fields = {path: field for path, field in shown.values.items() if not path.startswith(_IN_SECTIONS)}
    rows = [(path, field.units, field.text) for path, field in other_fields.items() if field.listed]
    table = text_table("All other fields of the file, except long arrays.", ("path", "unit", "value"), rows)
    arrays = plural(len(other_fields) - len(rows), "long array")
    yield Section("Other fields", (table, Paragraph(f"Not shown: {arrays}. --json gives their shapes.")))


def _texts(title: str, lines: Iterator[str]) -> Section:
    return Section(title, tuple(map(Paragraph, lines)))


def _limitations(shown: ShownCalibration) -> Iterator[str]:
    yield from (f"Reduced: {reason}." for reason in shown.validity.reduced)
    yield f"Assumed, not measured on this sensor: {', '.join(shown.assumed) or 'nothing'}."


def _validity(shown: ShownCalibration) -> Iterator[str]:
    validity = shown.validity
    yield f"force: {_range(validity.force_N, 'N')}"
    yield f"strain: {_range((100 * validity.strain[0], 100 * validity.strain[1]), '%')}"
    yield f"temperature: {_range(validity.temperature_C, '°C')}"
    yield f"place: within {validity.radius_mm:.3g} mm of the centre"
    yield f"head: {validity.indenter}"


def _range(ends: tuple[float, float] | None, unit: str) -> str:
    return "not measured" if ends is None else f"{ends[0]:.3g} to {ends[1]:.3g} {unit}"


def _baseline(places: tuple[BaselineConductance, ...]) -> Table:
    rows = [
        (
            place.location,
            format_fixed(place.x_mm, 1),
            format_fixed(place.y_mm, 1),
            "none" if place.value is None else f"{place.value:.4g}",
            "" if place.stderr is None else f"{place.stderr:.2g}",
            str(place.loads),
            place.why,
        )
        for place in places
    ]
    columns = ("place", "x [mm]", "y [mm]", "value", "± 1 s.e.", "loads", "remark")
    return text_table("In relative image units.", columns, rows, (1, 2, 3, 4, 5))


def _force(shown: ShownCalibration) -> Iterator[str]:
    force = shown.force_model
    if force is None:
        yield f"none: {shown.no_force_model}"
        return
    low, high = 100 * force.response_lowest, 100 * force.response_highest
    best_percent, worst_percent = 100 * force.response_stderr_lowest, 100 * force.response_stderr_highest
    yield (
        f"Response of the sheet: {low:.1f} to {high:.1f} % of that of its material, with a standard error of"
        f" {best_percent:.1f} to {worst_percent:.1f} %; single loads scatter by {100 * force.scatter:.1f} %."
    )
    x, y = force.least_force_worst_at_mm
    yield (
        f"Least force that one frame detects: {force.least_force_centre_N:.2g} N at the centre,"
        f" {force.least_force_worst_N:.2g} N at the worst place, ({x:z.3g}, {y:z.3g}) mm."
    )
    least, most = force.stress_kPa
    yield f"Learned from loads of {least:.3g} to {most:.3g} kPa, {force.hold_s:.3g} s after the press."
    yield f"Standard errors of force include {shown.force_error}."
    for standard in shown.standards:
        if standard.role == StandardRole.INDENTER:
            size = "area" if standard.unit == PERCENT else "diameter"
            yield f"Head, whose {size} counts for forces of other heads: {standard.words()}."
        elif standard.role != StandardRole.LOAD_CELL:
            yield f"{standard.role_words.capitalize()}: {standard.words()}."


def _tabulate_expanded_forces(forces: tuple[ShownExpandedForce, ...]) -> Table:
    rows = [
        (
            *(format_fixed(axis_mm, 1) for axis_mm in one.place_mm),
            f"{one.force_N:.3g}",
            f"{one.standard_uncertainty_N:#.2g}",
            format_dof(one.dof),
            f"{one.k:.2f}",
            f"{one.U_N:#.2g}",
            f"{one.in_use.U_N:#.2g}",
            "; ".join(_describe_random_numbers(one)),
            one.components[0].name,
        )
        for one in forces
    ]
    columns = ("x [mm]", "y [mm]", "force [N]", "u [N]", "dof", "k", "U [N]", "U in use [N]")
    missing, missing_in_use = (", ".join(one.not_stated) or "nothing" for one in (forces[0], forces[0].in_use))
    caption = (
        "For 95 %, of one settled load at a known place; u, dof, k and U on the day of calibration."
        f" U without: {missing}. U in use without: {missing_in_use}."
    )
    return text_table(caption, (*columns, "by random numbers [N]", "largest part"), rows, tuple(range(8)))


def _tabulate_components(force: ShownExpandedForce) -> Table:
    rows = [
        (
            part.name,
            part.kind,
            f"{part.standard_uncertainty_N:#.2g}" if part.standard_uncertainty_N else "0",
            format_dof(part.dof),
            f"{100 * part.share:.1f}",
            part.source,
        )
        for part in force.in_use.components
    ]
    place = ", ".join(f"{axis_mm:.3g}" for axis_mm in force.place_mm).replace("-", "−")
    caption = (
        f"Inputs of the largest U in use, of {force.force_N:.3g} N at ({place}) mm: A by statistics of observations,"
        " B otherwise (JCGM 100). --json has those of every force."
    )
    columns = ("input", "kind", "u [N]", "dof", "% of u²", "from")
    return text_table(caption, columns, rows, (2, 3, 4))


def _describe_random_numbers(force: ShownExpandedForce) -> Iterator[str]:
    """Yield intervals by random numbers, and why there are any."""
    for when, one in (("", force), ("in use ", force.in_use)):
        if one.monte_carlo_N is not None:
            low_N, high_N = one.monte_carlo_N
            yield f"{when}{low_N:.3g} to {high_N:.3g}: {one.monte_carlo_why}"


def _settling(summaries: tuple[Settling, ...]) -> Table:
    rows = [
        (
            f"{summary.signal}, {summary.direction}",
            "none" if summary.mean_s is None else f"{'at least ' if summary.censored else ''}{summary.mean_s:.3g}",
            "" if summary.deviation_s is None else f"{summary.deviation_s:.2g}",
            *map(str, (summary.accepted, summary.censored, summary.rejected)),
        )
        for summary in summaries
    ]
    columns = ("signal", "mean [s]", "deviation [s]", "settled", "later than window", "rejected")
    return text_table("Settling times over all loads.", columns, rows, (1, 2, 3, 4, 5))
