"""Rows of the paper's tables: printed number, simulated number, rule of agreement."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from cbsr_qa.studies.reproduce.compare import (
    ComparedRow,
    ComparedTable,
    Ours,
    Printed,
    PrintedRange,
    Rule,
    ValueOrigin,
    compare_value,
    make_table,
    mean_of_deviations,
    show_beside,
)
from cbsr_qa.studies.reproduce.reasons import NOTES, REASONS as WHY, TITLES
from cbsr_qa.studies.reproduce.values import ForcePress, SettlingOf, SheetValues, StripValues

#: Sheet and percentage → simulated sensor.
Sheets = Mapping[tuple[str, int], SheetValues]
Strips = Mapping[int, StripValues]
Tables = Mapping[str, Any]

_PERCENTS: Final = (8, 9)
#: Presses behind the paper's force error: six strains in three trials at L0, as we interpret 3.3.2.
_PAPER_PRESSES: Final = 18
_SPATIAL: Final = (("E_CoM", "mm"), ("A_OL", "%"), ("SD", "mm²"))


def compare_tables(paper: Tables, sheets: Sheets, strips: Strips) -> dict[str, ComparedTable]:
    """Compare the printed numbers of the shipped ``published/ellingham.toml`` with ours, table by table."""
    rows: dict[str, Iterator[ComparedRow]] = {
        "table1": _table1(paper, sheets, strips),
        "table2": _table2(paper, sheets),
        "table3": _table3(paper, sheets),
        "table4": _table4(paper, sheets),
        "table5": _random(paper, sheets, "table5_random_E_CoM_mm", 0),
        "tableF6": _random(paper, sheets, "tableF6_random_SD", 1),
        "settling": _settling(paper, sheets, strips),
        "force": _force(paper, sheets),
    }
    return {key: make_table(TITLES[key], NOTES[key], rows[key]) for key in rows}


def _list_sheets(sheets: Sheets, percent: int) -> list[SheetValues]:
    """The uniform sheet of a material, then the bench sheet if simulated."""
    return [sheets[sheet, percent] for sheet in ("uniform", "bench") if (sheet, percent) in sheets]


def _table1(paper: Tables, sheets: Sheets, strips: Strips) -> Iterator[ComparedRow]:
    printed = {row["wt_percent"]: row for row in paper["table1_material"]}
    for percent in _PERCENTS:
        row = printed[percent]
        group, pair, strip = f"{percent} wt%", _list_sheets(sheets, percent), strips[percent]
        modulus = Printed(row["E_kPa"], None, 0.05)
        factor = Printed(paper["gauge_factor"][str(percent)], None, 0.05)
        yield compare_value(
            group, "R_int", "kΩ", ValueOrigin.INPUT, Rule.DEVIATION, Printed(*row["R_int_kohm"]),
            [sheet.resistance for sheet in pair],
        )  # fmt: skip
        yield compare_value(group, "E", "kPa", ValueOrigin.INPUT, Rule.DIGITS, modulus, [strip.modulus])
        yield show_beside(group, "E on the sheet, 60 s held", "kPa", modulus, pair[0].modulus, WHY["modulus sheet"])
        yield compare_value(
            group, "gauge factor", "1", ValueOrigin.INPUT, Rule.DIGITS, factor, [strip.local_gauge_factor]
        )
        yield show_beside(
            group, "gauge factor between the pins", "1", factor, strip.gauge_factor, WHY["gauge factor pins"]
        )


def _table2(paper: Tables, sheets: Sheets) -> Iterator[ComparedRow]:
    for percent in _PERCENTS:
        group, pair, row = f"{percent} wt%", _list_sheets(sheets, percent), paper["table2_noise"][str(percent)]
        yield compare_value(
            group, "NF", "1", ValueOrigin.INPUT, Rule.DEVIATION, Printed(*row["NF"]),
            [sheet.noise_figure for sheet in pair], why=WHY["noise figure"],
        )  # fmt: skip
        floor = Printed(paper["relative_noise_floor"][str(percent)], None, 5e-6)
        yield compare_value(
            group, "noise floor, relative (3.3.2)", "1", ValueOrigin.INPUT, Rule.DIGITS, floor,
            [sheet.noise_floor for sheet in pair], why=WHY["noise floor"],
        )  # fmt: skip
        yield show_beside(
            group, "σ_n, printed in mS; ours relative", "1", Printed(row["sigma_n_mS_as_printed"]), pair[0].noise,
            WHY["noise in mS"],
        )  # fmt: skip


def _table3(paper: Tables, sheets: Sheets) -> Iterator[ComparedRow]:
    pair = _list_sheets(sheets, 8)
    for number, (mask, _) in enumerate(pair[0].by_mask):
        row = paper["table3_8wt_20pct_by_threshold"][f"{mask:.2f}"]
        for column, (name, unit) in enumerate(_SPATIAL):
            rule, why = Rule.DEVIATION, WHY[f"{name} mask"]
            if name == "A_OL":
                rule, why = Rule.BAND, f"{why} Our mean A_b/A_FA is {pair[0].size_ratio[number][1]:.1f}."
            our_values = [sheet.by_mask[number][1][column] for sheet in pair]
            group = f"mask {100 * mask:g} %"
            yield compare_value(
                group, name, unit, ValueOrigin.OUTCOME, rule, Printed(*row[column]), our_values, why=why
            )


def _table4(paper: Tables, sheets: Sheets) -> Iterator[ComparedRow]:
    pair = _list_sheets(sheets, 8)
    for number, (place, _) in enumerate(pair[0].by_place):
        row = paper["table4_8wt_20pct_85"][place]
        for column, (name, unit) in enumerate(_SPATIAL):
            our_values = [sheet.by_place[number][1][column] for sheet in pair]
            why = WHY["contradiction"] if place in ("L0", "L1", "L8") and name == "SD" else WHY[f"{name} place"]
            printed = Printed(*row[column])
            yield compare_value(place, name, unit, ValueOrigin.OUTCOME, Rule.DEVIATION, printed, our_values, why=why)


def _random(paper: Tables, sheets: Sheets, key: str, column: int) -> Iterator[ComparedRow]:
    name, unit = (("E_CoM", "mm"), ("SD", "mm²"))[column]
    for number, (radius_mm, angle_deg, strain_percent, *printed) in enumerate(paper[key]["rows"]):
        group = f"({radius_mm:g} mm, {angle_deg:g}°) {strain_percent:g} %"
        for percent, pair in zip(_PERCENTS, printed, strict=True):
            yield compare_value(
                group, f"{name}, {percent} wt%", unit, ValueOrigin.OUTCOME, Rule.DEVIATION, Printed(*pair),
                [sheet.random[number][column] for sheet in _list_sheets(sheets, percent)], why=WHY[f"{name} random"],
            )  # fmt: skip


def _settling(paper: Tables, sheets: Sheets, strips: Strips) -> Iterator[ComparedRow]:
    ranges = {"abstract": "abstract", "4.3.2": "discussion_4.3.2"}
    for percent in _PERCENTS:
        means = paper["settling_time_s_mean_range"]
        printed = Printed(
            ranges=tuple(PrintedRange(where, *means[key][str(percent)]) for where, key in ranges.items())
        )
        uniform, *bench = _list_sheets(sheets, percent)
        for settling in uniform.settlings:
            bench_values = [
                other.ours
                for sheet in bench
                for other in sheet.settlings
                if (other.strain, other.loading) == (settling.strain, settling.loading)
            ]
            yield _settling_row(f"{percent} wt%", settling, printed, bench_values)
        for settling in strips[percent].settlings:
            yield _settling_row(f"{percent} wt% in 1D", settling, printed, [])


def _settling_row(group: str, settling: SettlingOf, printed: Printed, beside: list[Ours]) -> ComparedRow:
    direction = "loading" if settling.loading else "unloading"
    name = "all strains in one fit" if settling.strain is None else f"{100 * settling.strain:g} % strain"
    our_values = [settling.ours, *beside]
    return compare_value(
        f"{group}, {direction}", name, "s", ValueOrigin.OUTCOME, Rule.RANGE, printed, our_values, why=WHY["settling"]
    )


def _force(paper: Tables, sheets: Sheets) -> Iterator[ComparedRow]:
    for percent in _PERCENTS:
        group, key, pair = f"{percent} wt%", str(percent), _list_sheets(sheets, percent)
        yield compare_value(
            group, "force error at L0, one ρ̄₀", "N", ValueOrigin.OUTCOME, Rule.SCATTER,
            Printed(paper["force_error_sd_N_at_L0"][key], None, 0.005), [force_error(sheet) for sheet in pair],
            why=WHY["force"], printed_count=_PAPER_PRESSES,
        )  # fmt: skip
        yield compare_value(
            group, "least force, from the noise floor", "N", ValueOrigin.OUTCOME, Rule.DIGITS,
            Printed(paper["min_force_N_as_printed"][key], None, 0.005), [least_force(sheet) for sheet in pair],
            why=WHY[f"least force {percent}"],
        )  # fmt: skip


def force_error(sheet: SheetValues) -> Ours:
    """Standard deviation of estimated less measured force at L0, for left-out trials [N]."""
    errors = np.array([press.global_N - press.measured_N for press in centre_presses(sheet)])
    if len(errors) < 3:
        return Ours(sheet.sheet, None, uncertainty_is="fewer than three presses at L0 could be left out")
    return mean_of_deviations(sheet.sheet, errors)


def centre_presses(sheet: SheetValues) -> tuple[ForcePress, ...]:
    """Presses at L0 left out of their own force model."""
    return tuple(press for press in sheet.presses if press.place == "L0")


def least_force(sheet: SheetValues) -> Ours:
    """Force whose conductance change equals the noise floor: floor / α_σ × area of the head [N] (paper 3.3.2)."""
    floor = sheet.noise_floor
    if floor.value is None:
        return floor
    newtons_per_unit = sheet.head_mm2 / sheet.stress_slope_per_kPa * 1e-3
    uncertainty = None if floor.uncertainty is None else newtons_per_unit * floor.uncertainty
    return Ours(sheet.sheet, newtons_per_unit * floor.value, uncertainty, floor.uncertainty_is, floor.count)
