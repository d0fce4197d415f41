"""Remarks on presses whose place may be wrong, on electrodes that no pair uses, and on ignored columns."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from cbsr_qa.calibration.presses.tables import LABELS, PressTable
from cbsr_qa.domain.geometry.outlines import SheetOutline
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.results.press_calibration import SheetRegistration

#: Times the median error of presses left out by which the place of one is doubtful. For normal errors in two
#: dimensions one press of 10^19 errs by so much.
_MANY_TIMES: Final = 8.0
#: Share of the largest such error: a wrong place misplaces its neighbours too, by less.
_OF_LARGEST: Final = 0.6
#: Standard errors of the pose by which a place must lie outside the sheet.
_CLEARLY: Final = 2.0
_MOST_NAMED: Final = 5


def name_off_sheet(presses: PressTable, registration: SheetRegistration, outline: SheetOutline) -> Iterator[str]:
    """Name presses whose places lie a little outside the outline of the registered sheet."""
    beyond_mm = -outline.clearance_mm(registration.on_sheet_mm(presses.place_mm))
    variance = np.linalg.eigvalsh(registration.covariance_mm2(presses.place_mm))[:, -1]
    rows = np.flatnonzero(beyond_mm > _CLEARLY * np.sqrt(variance) / registration.scale)
    if rows.size:
        named = _name_rows(rows, [f", {beyond:.1f} mm beyond its edge" for beyond in beyond_mm[rows[:_MOST_NAMED]]])
        yield f"{_count(rows)} outside the sheet, which {outline.words()}: {named}; check the labels"


def name_far_from_labels(presses: PressTable, rows: Indices, found_mm: Array) -> Iterator[str]:
    """Name presses that were found far from their labels without learning from them.

    Parameters
    ----------
    rows : (k,) rows of the presses left out.
    found_mm : (k, 2) places where they were found.
    """
    error_mm = np.linalg.norm(found_mm - presses.place_mm[rows], axis=1)
    usual_mm = float(np.median(error_mm))
    odd_presses = np.flatnonzero(error_mm > max(_MANY_TIMES * usual_mm, _OF_LARGEST * error_mm.max()))
    odd_presses = odd_presses[np.argsort(-error_mm[odd_presses], kind="stable")]
    if odd_presses.size:
        row_list = _name_rows(
            rows[odd_presses], [f" by {error:.3g} mm" for error in error_mm[odd_presses[:_MOST_NAMED]]]
        )
        placing = "the other presses place it" if len(odd_presses) == 1 else "the others place them"
        yield (
            f"{_count(odd_presses)} far from where {placing}, {row_list}; the median is {usual_mm:.2g} mm:"
            " check the labels and the readings"
        )


def list_ignored_columns(presses: PressTable) -> Iterator[str]:
    """Name columns of the table that are no labels."""
    ignored = [name for name in presses.table.columns if name not in LABELS]
    if ignored:
        yield f"{presses.table.path.name}: ignored columns: {', '.join(map(repr, ignored[:_MOST_NAMED]))}"


def list_unused_electrodes(pairs: Indices, electrodes: int) -> Iterator[str]:
    """Name electrodes of the sensor type that no pair (m, 4) uses."""
    unused = np.setdiff1d(np.arange(electrodes), pairs)
    if unused.size:
        runs = np.split(unused, np.flatnonzero(np.diff(unused) > 1) + 1)
        named = ", ".join(f"{run[0]}" if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs)
        yield (
            f"no pair uses electrodes {named} of the {electrodes} of the sensor type: check its number of electrodes,"
            " and the pattern"
        )


def _count(rows: Indices) -> str:
    return "1 press is" if len(rows) == 1 else f"{len(rows)} presses are"


def _name_rows(rows: Indices, words: list[str]) -> str:
    ellipsis = ", …" if len(rows) > len(words) else ""
    return ", ".join(f"row {row + 1}{remark}" for row, remark in zip(rows, words, strict=False)) + ellipsis
