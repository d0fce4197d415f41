"""MATLAB files of adjacent data of 16 or 32 electrodes as EIDORS distributes them (format ``eidors-mat``).

Of a file of version 5 (saved with -v6 or -v7) only real matrices are read. scipy.io would do the same for sound
files, but looks types up without checking them: a damaged file can crash it.

Structures, cells and objects are skipped unread: nested thousands deep, they exhaust the stack of any reader. Packed
variables are unpacked only when their header says a size that a file of this length may have.
"""

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    ElectrodeKind,
    ElectrodeLayout,
    FrameBlock,
    ReadingFlag,
    ReadOptions,
    Recording,
    RecordingError,
    ScanKind,
    VoltageUnit,
    adjacent_pattern,
)
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.system.untrusted import largest_content

HEADER_BYTES: Final = 128
_MATRIX: Final = 14
_PACKED: Final = 15
#: Bytes of a packed variable that hold its header, whatever its name.
_BEGINNING: Final = 1024
_MAX_VARIABLES: Final = 10_000
_NUMERIC_CLASSES: Final = range(6, 16)
_COMPLEX: Final = 0x0800
_LOGICAL: Final = 0x0200
_TYPES: Final = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}


@dataclass(frozen=True, slots=True)
class _Variable:
    """A variable's header: its values are the ``size_bytes`` behind byte ``start`` of its element."""

    name: str
    shape: tuple[int, ...]
    dtype: str
    start: int
    size_bytes: int
    is_complex: bool


def real_matrices(data: bytes, rows: Collection[int]) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Read the matrices of some numbers of rows and at least one column.

    Parameters
    ----------
    data : the whole file.
    rows : that are allowed.

    Returns
    -------
    The real ones in the file's order, (rows, n) float64, and the names of complex ones, which are not read.

    Raises
    ------
    ValueError
        If the file is cut or damaged, or claims more than a file of its length may hold.
    """
    matrices: dict[str, Array] = {}
    complex_ones: list[str] = []
    remaining_bytes = largest_content(len(data))
    for element, packed, order in _elements(data):
        variable = _header(_unpack(element, _BEGINNING) if packed else element[:_BEGINNING], order)
        if variable is None or len(variable.shape) != 2 or variable.shape[0] not in rows or not variable.shape[1]:
            continue
        if variable.is_complex:
            complex_ones.append(variable.name)
            continue
        remaining_bytes -= 8 * variable.shape[0] * variable.shape[1]
        if remaining_bytes < 0:
            raise ValueError(f"{variable.name} of {variable.shape} is too large for a file of {len(data)} bytes")
        if variable.size_bytes != variable.shape[0] * variable.shape[1] * np.dtype(variable.dtype).itemsize:
            raise ValueError(f"{variable.name} of {variable.shape} holds {variable.size_bytes} bytes")
        end = variable.start + variable.size_bytes
        values = (_unpack(element, end) if packed else element)[variable.start : end]
        if len(values) != variable.size_bytes:
            raise ValueError(f"{variable.name} is cut")
        flat = np.frombuffer(values, dtype=variable.dtype)
        matrices[variable.name] = flat.astype(np.float64).reshape(variable.shape, order="F")
    return matrices, tuple(complex_ones)


def _elements(data: bytes) -> Iterator[tuple[memoryview, bool, str]]:
    """Yield each variable's bytes, whether they are packed, and the byte order."""
    order = {b"IM": "<", b"MI": ">"}.get(data[126:HEADER_BYTES])
    if order is None:
        raise ValueError("its header states no byte order of version 5")
    offset, count, view = HEADER_BYTES, 0, memoryview(data)
    while offset + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, offset)
        count += 1
        if kind not in (_MATRIX, _PACKED) or count > _MAX_VARIABLES:
            raise ValueError(f"no variable begins at byte {offset}")
        if offset + 8 + length > len(data):
            raise ValueError(f"the variable at byte {offset} is cut")
        # Of what is packed, the first eight bytes repeat the kind and length of what is not.
        yield view[offset + 8 : offset + 8 + length], kind == _PACKED, order
        offset += 8 + length


def _unpack(element: memoryview, max_bytes: int) -> memoryview:
    """First bytes of a packed variable, after its tag."""
    try:
        return memoryview(zlib.decompressobj().decompress(element, max_bytes + 8))[8:]
    except zlib.error as error:
        raise ValueError(f"a variable cannot be unpacked: {error}") from error


def _header(element: memoryview, order: str) -> _Variable | None:
    """Read the header of a variable; None if it is not an array of numbers."""
    try:
        flags = struct.unpack_from(f"{order}I", element, 8)[0]
        if flags & 0xFF not in _NUMERIC_CLASSES or flags & _LOGICAL:
            return None
        _, start, length, offset = _part(element, 16, order)
        shape = struct.unpack_from(f"{order}{length // 4}i", element, start)
        _, start, length, offset = _part(element, offset, order)
        name = bytes(element[start : start + length]).decode("ascii", errors="replace")
        kind, start, length, _ = _part(element, offset, order)
    except struct.error as error:
        raise ValueError("the header of a variable is cut") from error
    if kind not in _TYPES or min(shape, default=-1) < 0:
        raise ValueError(f"{name} of {shape} holds values of the unknown type {kind}")
    return _Variable(name, shape, order + _TYPES[kind], start, length, bool(flags & _COMPLEX))


def _part(element: memoryview, offset: int, order: str) -> tuple[int, int, int, int]:
    """Kind, start and length of a part of a variable, and where the next begins."""
    kind, length = struct.unpack_from(f"{order}II", element, offset)
    if kind >> 16:  # a short one: up to four bytes, within the tag
        return kind & 0xFFFF, offset + 4, min(kind >> 16, 4), offset + 8
    return kind, offset + 8, length, offset + 8 + (length + 7) // 8 * 8


#: Rows of matrices that hold frames, by the electrodes of the ring: every drive pair with every measure pair.
_ELECTRODES: Final = {count**2: count for count in (16, 32)}
_ROWS: Final = " or ".join(map(str, _ELECTRODES))
_HEADER_BYTES: Final = 512  # in front of the HDF5 part of a file of version 7.3
#: More than any such file; all of it is in memory.
_MAX_FILE_BYTES: Final = 2**29
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
#: Frame rates the data's authors state; the files themselves hold no times.
_DOCUMENTED_RATE_HZ: Final = {"zc_demo": 7.0, "zc_resp": 7.0, "zc_breathhold": 7.0}

Matrix = NDArray[np.float64]


class EidorsMat:
    """Reads matrices of 256 (1024) rows, index 16 (32)·drive + measure, one column a frame, absolute values.

    Every such matrix is a data set; what one is compared with follows from the naming convention of these files
    (``zc_h_X`` is the homogeneous frame of ``zc_X``, ``vvRef`` that of ``vvAvg1`` …) unless a reference is named.
    Electrode 0 lies on +x and a quarter round comes the one on +y.
    """

    def recognises(self, path: Path, head: bytes) -> bool:
        """Recognise the header of MATLAB files; HDF5 with that suffix is refused with advice on saving."""
        return head.startswith((b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")) or (
            path.suffix == ".mat" and head.startswith((b"MATLAB", _HDF5))
        )

    def datasets(self, path: Path) -> tuple[str, ...]:
        """Name the matrices of frames, in the file's order."""
        return tuple(_matrices(path))

    def read(self, path: Path, options: ReadOptions) -> Recording:
        """Read one data set, and the reference its name points to unless the options name one.

        Returns
        -------
        Recording with (n, 16, 16) or (n, 32, 32) frames; readings at driven electrodes are flagged MISSING.

        Raises
        ------
        RecordingError
            If the file is damaged, lacks such a matrix or the requested one, or holds several and none was chosen.
        """
        matrices = _matrices(path, options.dataset)
        name = _choose_dataset(path, matrices, options.dataset)
        matrix = matrices[name]
        reference, reference_note = _reference(matrices, name) if options.reference is None else (None, "")
        still = matrix.shape[1] == 1
        rate_hz = None if still else next((r for p, r in _DOCUMENTED_RATE_HZ.items() if name.startswith(p)), None)
        notes = [reference_note, "readings are absolute values: signs are put back from the pattern's geometry"]
        if rate_hz is not None:
            notes.append(f"the file holds no times; its authors document {rate_hz:g} frames a second")
        elif not still:
            notes.append("the file holds no times: frame numbers stand in for seconds")
        return Recording(
            path=path,
            format="eidors-mat",
            dataset=name,
            scan=ScanKind.FULL,
            frames=_block(matrix, rate_hz),
            reference=reference,
            still=still,
            magnitudes_only=True,
            clock="documented" if rate_hz is not None else "none",
            layout=ElectrodeLayout(_ELECTRODES[len(matrix)], ElectrodeKind.ARC, 1.0, 0.1, 0.0, counterclockwise=True),
            notes=tuple(note for note in notes if note),
        )


def _matrices(path: Path, asked: str | None = None) -> dict[str, Matrix]:
    data = read_foreign(path, _MAX_FILE_BYTES)
    if data.startswith((_HDF5, b"MATLAB 7.3")) or data[_HEADER_BYTES:].startswith(_HDF5):
        raise RecordingError(
            f"{path.name} is a MATLAB file of version 7.3 (HDF5)", remedy="save it in MATLAB or Octave with -v7"
        )
    try:
        matrices, alternating = real_matrices(data, _ELECTRODES)
    except ValueError as error:
        raise RecordingError(
            f"{path.name} cannot be read as a MATLAB file: {error}",
            remedy="it is cut, damaged or of another format; get it again",
        ) from error
    finite = {name: matrix for name, matrix in matrices.items() if np.isfinite(matrix).all()}
    unfit = [name for name in (*alternating, *matrices) if name not in finite and (not finite or name == asked)]
    _refuse_unfit(path, unfit, alternating)
    if not finite:
        raise RecordingError(
            f"{path.name} holds no matrix of {_ROWS} rows",
            remedy=f"frames are columns of {_ROWS} values, index 16 or 32·drive + measure",
        )
    return finite


def _refuse_unfit(path: Path, names: list[str], alternating: tuple[str, ...]) -> None:
    """Refuse data sets that hold no frames of direct current."""
    complex_ones = [name for name in names if name in alternating]
    if complex_ones:
        raise RecordingError(
            f"{path.name}: {', '.join(complex_ones)} holds complex voltages (alternating current), not real ones",
            remedy="save the real part as a separate data set, if those are the frames",
        )
    if names:
        raise RecordingError(
            f"{path.name}: {', '.join(names)} holds values that are not finite numbers",
            remedy="a frame needs all of its values; get the file again",
        )


def _choose_dataset(path: Path, matrices: dict[str, Matrix], asked: str | None) -> str:
    if asked is None and len(matrices) == 1:
        return next(iter(matrices))
    counts = {name: matrix.shape[1] for name, matrix in matrices.items()}
    listed = ", ".join(f"{name} ({count} frame{'' if count == 1 else 's'})" for name, count in counts.items())
    if asked is None:
        raise RecordingError(
            f"{path.name} holds {len(matrices)} data sets and none was chosen: {listed}",
            remedy="choose one with --dataset NAME",
        )
    if asked not in matrices:
        raise RecordingError(f"{path.name} has no data set {asked!r}; it has {listed}", remedy="choose one of these")
    return asked


def _reference(matrices: dict[str, Matrix], name: str) -> tuple[FrameBlock | None, str]:
    conventional = "vvRef" if name.startswith("vvAvg") else "zc_h_" + name.removeprefix("zc_")
    if not name.startswith(("vvAvg", "zc_")) or name.startswith("zc_h_") or conventional not in matrices:
        return None, ""
    if len(matrices[conventional]) != len(matrices[name]):
        return None, f"{conventional} of the same file is of another ring, and not what changes are against"
    return _block(matrices[conventional], None), f"changes are against {conventional} of the same file, by its name"


def _block(matrix: Matrix, rate_hz: float | None) -> FrameBlock:
    """Frames of a matrix. Driven positions were not measured: their values are not readings."""
    count = _ELECTRODES[len(matrix)]
    frames = matrix.T.reshape(-1, count, count)
    times = np.arange(len(frames), dtype=np.float64) / (rate_hz or 1.0)
    usable = adjacent_pattern(count).usable()
    flags = np.broadcast_to(np.where(usable, 0, ReadingFlag.MISSING.value).astype(np.uint8), frames.shape).copy()
    whole = bool((matrix == np.round(matrix)).all())
    return FrameBlock(
        times, np.where(usable, frames, 0.0), flags, VoltageUnit.COUNT if whole else VoltageUnit.VOLT, None
    )
