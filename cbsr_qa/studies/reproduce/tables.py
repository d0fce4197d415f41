"""Rows of the paper's tables: printed number, simulated number, rule of agreement."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from cbsr_qa.studies.reproduce.compare import (
    NOTES,
    REASONS as WHY,
    TITLES,
    ComparedTable,
    Comparison,
    Kind,
    Ours,
    Printed,
    Rule,
    compared,
    mean_of_deviations,
    not_compared,
)
from cbsr_qa.studies.reproduce.figures import ForcePress, SettlingOf, SheetFigures, StripFigures

#: Sheet and percentage → what was simulated.
Sheets = Mapping[tuple[str, int], SheetFigures]
Strips = Mapping[int, StripFigures]
Tables = Mapping[str, Any]

_PERCENTS: Final = (8, 9)
#: Presses behind the paper's force error: six strains in three trials at L0, as we read 3.3.2.
_PAPER_PRESSES: Final = 18
_SPATIAL: Final = (("E_CoM", "mm"), ("A_OL", "%"), ("SD", "mm²"))


def compared_tables(paper: Tables, sheets: Sheets, strips: Strips) -> tuple[ComparedTable, ...]:
    """Compare everything.

    Parameters
    ----------
    paper : the printed numbers, as in the shipped file ``published/ellingham.toml``.
    sheets : the uniform sheet of both materials, and the bench sheet where it was simulated.
    """
    makers: dict[str, Iterator[Comparison]] = {
        "table1": _table1(paper, sheets, strips),
        "table2": _table2(paper, sheets),
        "table3": _table3(paper, sheets),
        "table4": _table4(paper, sheets),
        "table5": _random(paper, sheets, "table5_random_E_CoM_mm", 0),
        "tableF6": _random(paper, sheets, "tableF6_random_SD", 1),
        "settling": _settling(paper, sheets, strips),
        "force": _force(paper, sheets),
    }
    return tuple(ComparedTable(key, TITLES[key], tuple(rows), NOTES[key]) for key, rows in makers.items())


def _pair(given: list[float]) -> Printed:
    return Printed(given[0], given[1] if len(given) > 1 else None)


def _beside(sheets: Sheets, percent: int, take: Callable[[SheetFigures], Ours]) -> tuple[Ours, ...]:
    bench = sheets.get(("bench", percent))
    return () if bench is None else (take(bench),)


def _table1(paper: Tables, sheets: Sheets, strips: Strips) -> Iterator[Comparison]:
    printed = {row["wt_percent"]: row for row in paper["table1_material"]}
    for percent in _PERCENTS:
        group, row, strip = f"{percent} wt%", printed[percent], strips[percent]
        sheet = sheets["uniform", percent]
        beside = _beside(sheets, percent, lambda one: one.resistance)
        yield compared(
            group, "R_int", "kΩ", Kind.INPUT, Rule.DEVIATION, _pair(row["R_int_kohm"]), sheet.resistance, beside
        )
        modulus = Printed(row["E_kPa"], None, 0.05)
        yield compared(group, "E", "kPa", Kind.INPUT, Rule.DIGITS, modulus, strip.modulus)
        yield not_compared(group, "E on the sheet, 60 s held", "kPa", modulus, sheet.modulus, WHY["modulus sheet"])
        factor = Printed(paper["gauge_factor"][str(percent)], None, 0.05)
        yield compared(group, "gauge factor", "1", Kind.INPUT, Rule.DIGITS, factor, strip.local_gauge_factor)
        yield not_compared(
            group, "gauge factor between the pins", "1", factor, strip.gauge_factor, WHY["gauge factor pins"]
        )


def _table2(paper: Tables, sheets: Sheets) -> Iterator[Comparison]:
    for percent in _PERCENTS:
        group, key, sheet = f"{percent} wt%", str(percent), sheets["uniform", percent]
        row = paper["table2_noise"][key]
        yield compared(
            group, "NF", "1", Kind.INPUT, Rule.DEVIATION, _pair(row["NF"]), sheet.noise_figure,
            _beside(sheets, percent, lambda one: one.noise_figure), why=WHY["noise figure"],
        )  # fmt: skip
        floor = Printed(paper["relative_noise_floor"][key], None, 5e-6)
        yield compared(
            group, "noise floor, relative (3.3.2)", "1", Kind.INPUT, Rule.DIGITS, floor, sheet.noise_floor,
            _beside(sheets, percent, lambda one: one.noise_floor), why=WHY["noise floor"],
        )  # fmt: skip
        yield not_compared(
            group, "σ_n, printed in mS; ours relative", "1", Printed(row["sigma_n_mS_as_printed"]), sheet.noise,
            WHY["noise in mS"],
        )  # fmt: skip


def _table3(paper: Tables, sheets: Sheets) -> Iterator[Comparison]:
    sheet, bench = sheets["uniform", 8], sheets.get(("bench", 8))
    printed = paper["table3_8wt_20pct_by_threshold"]
    for number, (mask, (figures, _)) in enumerate(sheet.by_mask):
        row = printed[f"{mask:.2f}"]
        for column, (name, unit) in enumerate(_SPATIAL):
            rule = Rule.BAND if name == "A_OL" else Rule.DEVIATION
            beside = () if bench is None else (bench.by_mask[number][1][0][column],)
            why = WHY[f"{name} mask"]
            if name == "A_OL":
                why += f" Our mean A_b/A_FA is {sheet.size_ratio[number][1]:.1f}."
            yield compared(
                f"mask {100 * mask:g} %", name, unit, Kind.OUTCOME, rule, _pair(row[column]), figures[column], beside,
                why=why,
            )  # fmt: skip


def _table4(paper: Tables, sheets: Sheets) -> Iterator[Comparison]:
    sheet, bench = sheets["uniform", 8], sheets.get(("bench", 8))
    for number, (place, (figures, _)) in enumerate(sheet.by_place):
        row = paper["table4_8wt_20pct_85"][place]
        for column, (name, unit) in enumerate(_SPATIAL):
            beside = () if bench is None else (bench.by_place[number][1][0][column],)
            printed = _pair(row[column])
            why = WHY["contradiction"] if place in ("L0", "L1", "L8") and name == "SD" else WHY[f"{name} place"]
            yield compared(place, name, unit, Kind.OUTCOME, Rule.DEVIATION, printed, figures[column], beside, why=why)


def _random(paper: Tables, sheets: Sheets, key: str, column: int) -> Iterator[Comparison]:
    name, unit = (("E_CoM", "mm"), ("SD", "mm²"))[column]
    for number, (radius_mm, angle_deg, strain_percent, *printed) in enumerate(paper[key]["rows"]):
        for percent, pair in zip(_PERCENTS, printed, strict=True):
            sheet, bench = sheets["uniform", percent], sheets.get(("bench", percent))
            beside = () if bench is None else (bench.random[number][column],)
            group = f"({radius_mm:g} mm, {angle_deg:g}°) {strain_percent:g} %"
            yield compared(
                group, f"{name}, {percent} wt%", unit, Kind.OUTCOME, Rule.DEVIATION, _pair(pair),
                sheet.random[number][column], beside, why=WHY[f"{name} random"],
            )  # fmt: skip


def _settling(paper: Tables, sheets: Sheets, strips: Strips) -> Iterator[Comparison]:
    ranges = paper["settling_time_s_mean_range"]
    for percent in _PERCENTS:
        key, bench = str(percent), sheets.get(("bench", percent))
        named = (
            ("abstract", *ranges["abstract"][key]),
            ("4.3.2", *ranges["discussion_4.3.2"][key]),
        )
        printed = Printed(ranges=named)
        for one in sheets["uniform", percent].settlings:
            others = () if bench is None else bench.settlings
            beside = tuple(o.ours for o in others if (o.strain, o.loading) == (one.strain, one.loading))
            yield compared(
                f"{percent} wt%, {_direction(one)}", _strain(one), "s", Kind.OUTCOME, Rule.RANGE, printed, one.ours,
                beside, why=WHY["settling"],
            )  # fmt: skip
        for one in strips[percent].settlings:
            group = f"{percent} wt% in 1D, {_direction(one)}"
            yield compared(group, _strain(one), "s", Kind.OUTCOME, Rule.RANGE, printed, one.ours, why=WHY["settling"])


def _direction(one: SettlingOf) -> str:
    return "loading" if one.loading else "unloading"


def _strain(one: SettlingOf) -> str:
    return "all strains in one fit" if one.strain is None else f"{100 * one.strain:g} % strain"


def _force(paper: Tables, sheets: Sheets) -> Iterator[Comparison]:
    for percent in _PERCENTS:
        group, key, sheet = f"{percent} wt%", str(percent), sheets["uniform", percent]
        printed = Printed(paper["force_error_sd_N_at_L0"][key], None, 0.005)
        yield compared(
            group, "force error at L0, one ρ̄₀", "N", Kind.OUTCOME, Rule.SCATTER, printed, force_error(sheet),
            _beside(sheets, percent, force_error), why=WHY["force"], printed_count=_PAPER_PRESSES,
        )  # fmt: skip
        limit = Printed(paper["min_force_N_as_printed"][key], None, 0.005)
        yield compared(
            group, "least force, from the noise floor", "N", Kind.OUTCOME, Rule.DIGITS, limit, least_force(sheet),
            _beside(sheets, percent, least_force), why=WHY[f"least force {percent}"],
        )  # fmt: skip


def force_error(sheet: SheetFigures) -> Ours:
    """Standard deviation of estimated less measured force at L0, trials left out of what estimates them [N]."""
    errors = np.array([one.global_N - one.measured_N for one in centre_presses(sheet)])
    if len(errors) < 3:
        return Ours(sheet.sheet, None, of="fewer than three presses at L0 could be left out")
    return mean_of_deviations(sheet.sheet, errors)


def centre_presses(sheet: SheetFigures) -> tuple[ForcePress, ...]:
    """Presses at L0 that were left out of what estimates their force."""
    return tuple(one for one in sheet.presses if one.place == "L0")


def least_force(sheet: SheetFigures) -> Ours:
    """Force whose change of conductance is the noise floor: floor / α_σ × area of the head [N] (paper 3.3.2)."""
    floor = sheet.noise_floor
    if floor.value is None:
        return floor
    each = sheet.head_mm2 / sheet.stress_slope_per_kPa * 1e-3
    uncertainty = None if floor.uncertainty is None else each * floor.uncertainty
    return Ours(sheet.sheet, each * floor.value, uncertainty, floor.of, floor.count)
