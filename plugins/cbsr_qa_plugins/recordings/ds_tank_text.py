"""Text files of the DS tank phantom (EIDORS contributed data ``ds_tank_phantom``; format ``ds-tank-text``)."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.errors import RecordingError
from cbsr_qa.domain.frames import FrameBlock, ReadingFlag, VoltageUnit
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.domain.recording import ReadOptions, Recording, RowProblem, ScanKind

_ELECTRODES: Final = 16
_LENGTH: Final = 208  # 16 drives × 13 measure pairs that touch no driven electrode
_START: Final = "#Start"
_COLUMNS: Final = 3  # Vr, Vi, I


class DsTankText:
    """Reads one averaged frame a file; the empty tank is a file of its own.

    The in-phase voltage Vr is used. Dividing it by the current column makes reciprocity worse (14 % against 1.3 %),
    so it is not divided. Values are magnitudes: the sign of the pattern's geometry is put back by the analysis.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        """Tell by the ``#MEAS`` first line and the ``#Vector, Vr Vi I`` line."""
        return head.lstrip().startswith(b"#MEAS") and b"#Vector" in head

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Such a file is one data set."""
        return ()

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read a file, and the reference file the options name.

        Returns
        -------
        Recording with one (1, 16, 16) frame; readings that touch a driven electrode are flagged MISSING.

        Raises
        ------
        RecordingError
            If the file has no ``#Start`` line, or not 208 rows of three numbers (a repeated last row is let pass).
        """
        if options.dataset:
            raise RecordingError(f"{path.name} is one data set; it has none named {options.dataset!r}")
        frame, problems = _read_frame(path)
        reference = None
        notes = ["the in-phase voltages Vr are used, as recorded, not divided by the current"]
        if options.reference is not None:
            reference, more = _read_frame(options.reference[0])
            problems += [RowProblem(p.line, f"reference {options.reference[0].name}: {p.what}", False) for p in more]
            notes.append(f"changes are against {options.reference[0].name}")
        return Recording(
            path=path,
            format="ds-tank-text",
            dataset="",
            scan=ScanKind.FULL,
            frames=frame,
            reference=reference,
            still=True,
            magnitudes_only=True,
            clock="none",
            problems=tuple(problems),
            layout=ElectrodeLayout(_ELECTRODES, ElectrodeKind.ARC, 1.0, 0.1, 90.0, counterclockwise=False),
            notes=tuple(notes),
        )


def _read_frame(path: Path) -> tuple[FrameBlock, list[RowProblem]]:
    lines = path.read_text(encoding="latin-1").split("\n")
    start = next((k for k, line in enumerate(lines) if line.strip() == _START), None)
    if start is None:
        raise RecordingError(f"{path.name} has no {_START} line", remedy="this is not a whole DS tank file")
    rows = [(k + 1, line.split()) for k, line in enumerate(lines) if k > start and line.strip()]
    values, problems = _values(path, rows)
    if len(values) == _LENGTH + 1 and rows[-1][1] == rows[-2][1]:
        problems.append(RowProblem(rows[-1][0], "the last row is written twice; the copy is left out", True))
        values = values[:-1]
    if len(values) != _LENGTH:
        bad = f" ({len(problems)} could not be read, the first in line {problems[0].line})" if problems else ""
        raise RecordingError(
            f"{path.name} has {len(values)} rows of readings{bad}; a frame has {_LENGTH}",
            remedy="the file is cut or joined; get it again from its source",
        )
    return _frame(np.array(values)), problems


def _values(path: Path, rows: list[tuple[int, list[str]]]) -> tuple[list[float], list[RowProblem]]:
    values: list[float] = []
    problems: list[RowProblem] = []
    for line, fields in rows:
        try:
            numbers = [float(field) for field in fields]
        except ValueError:
            numbers = []
        if len(numbers) != _COLUMNS or not np.isfinite(numbers).all():
            problems.append(RowProblem(line, f"{' '.join(fields)[:40]!r} is not three numbers Vr Vi I", True))
        else:
            values.append(numbers[0])
    return values, problems


def _frame(values: NDArray[np.float64]) -> FrameBlock:
    """Row i is drive pair i; measure pairs rise in absolute order and skip i−1, i and i+1."""
    usable = adjacent_pattern(_ELECTRODES).usable()
    voltages = np.zeros((1, _ELECTRODES, _ELECTRODES))
    voltages[0][usable] = values
    flags = np.where(usable, 0, ReadingFlag.MISSING.value).astype(np.uint8)[None]
    return FrameBlock(np.zeros(1), voltages, flags, VoltageUnit.VOLT, None)
