"""Text files of the DS tank phantom (EIDORS contributed data ``ds_tank_phantom``; format ``ds-tank-text``)."""

from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    ElectrodeKind,
    ElectrodeLayout,
    FrameBlock,
    ReadingFlag,
    Recording,
    RecordingError,
    RowProblem,
    ScanKind,
    VoltageUnit,
    adjacent_pattern,
)
from cbsr_qa_plugins.recordings.lab_files import OneDataSet, number, text_lines

_ELECTRODES: Final = 16
_LENGTH: Final = 208  # 16 drives × 13 measure pairs that touch no driven electrode
_START: Final = "#Start"
_COLUMNS: Final = 3  # Vr, Vi, I
_MAX_LINES: Final = 1000  # these files have some 220
_MAX_VALUE: Final = 1e6  # no voltage or current of a tank

Rows = list[tuple[int, list[str]]]


class DsTankText(OneDataSet):
    """Reads one averaged frame a file; the empty tank has its own file.

    The in-phase voltage Vr is used. Dividing it by the current column makes reciprocity worse (14 % against 1.3 %),
    so it is not divided. Values are magnitudes: the sign of the pattern's geometry is put back by the analysis.
    Readings that touch a driven electrode are flagged MISSING. A copy of the last row is left out; any other row too
    few, too many or unreadable refuses the file: readings have no place but their order.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        """Recognise the ``#MEAS`` first line and the ``#Vector, Vr Vi I`` line."""
        return head.lstrip().startswith(b"#MEAS") and b"#Vector" in head

    def _read(self, path: Path) -> Recording:
        frame, problems = _read_frame(path)
        return Recording(
            path=path,
            format="ds-tank-text",
            dataset="",
            scan=ScanKind.FULL,
            frames=frame,
            still=True,
            magnitudes_only=True,
            clock="none",
            problems=tuple(problems),
            layout=ElectrodeLayout(_ELECTRODES, ElectrodeKind.ARC, 1.0, 0.1, 90.0, counterclockwise=False),
            notes=("the in-phase voltages Vr are used, as recorded, not divided by the current",),
        )


def _read_frame(path: Path) -> tuple[FrameBlock, list[RowProblem]]:
    rows, problems = _rows(path)
    bad = [(line, fields) for line, fields in rows if _voltage(fields) is None]
    if bad:
        problems = [RowProblem(k, f"{' '.join(f)[:40]!r} is not three numbers Vr Vi I", True) for k, f in bad]
        raise RecordingError(
            f"{path.name}: line {problems[0].line}: {problems[0].what}; {len(bad)} of its {len(rows)} rows are bad",
            remedy="readings have no place but their order, so no row can be left out: get the file again",
            problems=problems,
        )
    if len(rows) != _LENGTH:
        raise RecordingError(
            f"{path.name} has {len(rows)} rows of readings; a frame has {_LENGTH}",
            remedy="the file is cut or joined; get it again from its source",
            problems=problems,
        )
    return _frame(np.array([_voltage(fields) for _, fields in rows], dtype=np.float64)), problems


def _rows(path: Path) -> tuple[Rows, list[RowProblem]]:
    """Return the rows by line, without the repeated last one of these files."""
    lines = islice(text_lines(path), _MAX_LINES)
    if not any(line.text.strip() == _START for line in lines):
        raise RecordingError(f"{path.name} has no {_START} line", remedy="this is not a whole DS tank file")
    rows = [(line.number, line.text.split()) for line in lines if line.text.strip()]
    if len(rows) > 1 and rows[-1][1] == rows[-2][1]:
        copy, _ = rows.pop()
        return rows, [RowProblem(copy, "the last row is written twice; the copy is left out", True)]
    return rows, []


def _voltage(fields: list[str]) -> float | None:
    """Vr of a row; None if it is not three numbers."""
    numbers = [number(field) for field in fields]
    possible = all(value is not None and abs(value) <= _MAX_VALUE for value in numbers)
    return numbers[0] if possible and len(numbers) == _COLUMNS else None


def _frame(values: Array) -> FrameBlock:
    """Row i is drive pair i; measure pairs rise in absolute order and skip i−1, i and i+1."""
    usable = adjacent_pattern(_ELECTRODES).usable()
    voltages = np.zeros((1, _ELECTRODES, _ELECTRODES))
    voltages[0][usable] = values
    flags = np.where(usable, 0, ReadingFlag.MISSING.value).astype(np.uint8)[None]
    return FrameBlock(np.zeros(1), voltages, flags, VoltageUnit.VOLT, None)
