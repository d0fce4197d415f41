"""Files with changed bytes, each known by its source and number, and what reading one may come to."""

import io
import json
import os
import random
import re
import resource
import time
from functools import cache
from pathlib import Path

import h5py
import scipy.io
from board_files import BoardFile, counts
from calibration_samples import sample_calibration
from test_recording_file import sample
from test_smu_rig_csv import HEADER, frames, lines_of
from test_tank_formats import ds_file, vectors

from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.app.calibration.file import read_any
from cbsr_qa.app.calibration.signing import verify_file
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.file.json import json_document
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.plugin.discovery import discover

#: A file is read or refused within this processor time, which other work does not lengthen [s].
LONGEST_S = 10.0
#: And within this time on a clock, whatever else the computer does: a reader that waits uses no processor time [s].
LONGEST_WAIT_S = 60.0
#: Nor does any process take more memory.
MOST_BYTES = 1_500_000_000


def _calibration(folder):
    write_calibration(folder / "c.h5", sample_calibration())
    return (folder / "c.h5").read_bytes()


def _recording(folder):
    write_recording(folder / "r.h5", sample())
    return (folder / "r.h5").read_bytes()


def _mat(*, packed):
    file = io.BytesIO()
    content = {"zc_a": vectors(3)[1], "zc_h_a": vectors(1, 2)[1], "s": {"a": [1, {"b": 2}]}, "note": "words"}
    scipy.io.savemat(file, content, do_compression=packed)
    return file.getvalue()


def _board(folder, **kind):
    path = BoardFile(**kind).header().frames(counts(2)).log().frames(counts(2, seed=2)).save(folder)
    return path.read_bytes()


#: Bytes of whole files by the name they are saved under.
SOURCES = {
    "calibration.h5": _calibration,
    "old-calibration.h5": lambda folder: _calibration(folder)[512:],
    "calibration.json": lambda folder: json.dumps(json_document(sample_calibration())).encode(),
    "recording.h5": _recording,
    "packed.mat": lambda folder: _mat(packed=True),
    "plain.mat": lambda folder: _mat(packed=False),
    "board.csv": _board,
    "board-alone.csv": lambda folder: _board(folder, mass=False, clock=False),
    "rig.csv": lambda folder: "\n".join(HEADER + lines_of(frames(2))).encode(),
    "tank.txt": lambda folder: ds_file(folder, "t.txt", [0.01 + k / 1e5 for k in range(208)]).read_bytes(),
}
_NAMES = tuple(SOURCES)
#: What decides in a text how it goes on.
_TOKENS = re.compile(rb"[\[\]{}:,#\n]")
_INTEGERS = (0, 1, 2, 7, 0x7F, 0x80, 0xFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1)


def _fields(data: bytes) -> list[int]:
    """Bytes that say what follows: all of an HDF5 file but its data, the headers of others, tokens of texts."""
    if (begins := data.find(b"\x89HDF")) < 0:
        text = data.isascii() or data.startswith(b"{")
        return [match.start() for match in _TOKENS.finditer(data)] if text else list(range(100, min(300, len(data))))
    values: set[int] = set()

    def add(_, item):
        if not isinstance(item, h5py.Dataset):
            return
        kept = [item.id.get_chunk_info(k) for k in range(item.id.get_num_chunks())] if item.chunks else []
        where = [(chunk.byte_offset, chunk.size) for chunk in kept] or [(item.id.get_offset(), item.nbytes)]
        for offset, size in where:
            values.update(range(offset or 0, (offset or 0) + size))

    with h5py.File(io.BytesIO(data)) as file:
        file.visititems(add)
    return [at for at in range(begins, len(data)) if at - begins not in values and data[at]]


class Mutations:
    """Makes any changed file of any source; the same number is the same file."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._whole = {name: make(folder) for name, make in SOURCES.items()}
        self._places = {name: _fields(data) for name, data in self._whole.items()}

    def file(self, number: int) -> Path:
        """Write the file of a number and return its path."""
        name = _NAMES[number % len(_NAMES)]
        rng = random.Random(f"{name} {number}")
        data = bytearray(self._whole[name])
        for _ in range(rng.choice((1, 1, 1, 2, 5, 20))):
            data = self._changed(name, data, rng)
        path = self._folder / f"{number}-{name}"
        path.write_bytes(data)
        return path

    def _changed(self, name, data, rng):
        at, length = self._place(name, len(data), rng), rng.choice((1, 4, 8, 64, 512))
        match rng.choices(range(7), (4, 4, 4, 1, 1, 1, 1))[0]:
            case 0:
                data[at : at + 1] = bytes([data[at] ^ 1 << rng.randrange(8)] if at < len(data) else [])
            case 1:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 2:
                width = rng.choice((1, 2, 4, 8))
                value = rng.choice((*_INTEGERS, len(data), rng.randrange(len(data) + 1)))
                data[at : at + width] = (value % 256**width).to_bytes(width, "little")
            case 3:
                data[at:at] = rng.randbytes(length)
            case 4:
                del data[at : at + length]
            case 5:
                other = self._whole[rng.choice(_NAMES)] if rng.random() < 0.3 else data
                start = rng.randrange(len(other) + 1)
                data[at : at + length] = other[start : start + length]
            case 6:
                del data[at if rng.random() < 0.3 else len(data) :]
        return data or bytearray(b"\n")

    def _place(self, name, length, rng):
        places = self._places[name]
        if places and rng.random() < 0.7:
            return min(rng.choice(places) + rng.randrange(3), length - 1)
        return rng.randrange(length)


@cache
def _plugins():
    return discover()


def _read(path: Path) -> None:
    if "calibration" in path.name:
        if path.suffix == ".h5":
            verify_file(path)
        read_any(path)
    else:
        read_recording_file(path, _plugins(), format_=None, dataset="zc_a" if path.suffix == ".mat" else None)


def judged(path: Path) -> tuple[str, str]:
    """Read a file as commands do: what came of it, and what is wrong with that; empty where nothing is."""
    began_s, used_s = time.monotonic(), _processor_s()
    try:
        _read(path)
        outcome = "read"
    except RefusedError as error:
        outcome = error.reason
    except Exception as error:  # noqa: BLE001 - whatever a user would be told is an internal error
        return "broken", f"{type(error).__name__}: {error}"
    used_s, waited_s = _processor_s() - used_s, time.monotonic() - began_s
    too_long = used_s > LONGEST_S or waited_s > LONGEST_WAIT_S
    return outcome, f"took {used_s:.1f} s of processor time, {waited_s:.1f} s" if too_long else ""


def _processor_s() -> float:
    """Processor time of this process and of the children that have ended."""
    return sum(os.times()[:4])


class Memory:
    """Memory taken from now on: what earlier tests of this process needed does not count."""

    def __init__(self) -> None:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the peak begins anew
        self._before = _status_bytes("VmRSS")
        self._children = _children_bytes()

    def peak_bytes(self) -> int:
        """Largest growth of this process, or of a child beyond what it began with as a copy of this process."""
        own, children = _status_bytes("VmHWM"), _children_bytes()
        return max(own, children if children > self._children else 0) - self._before


def _status_bytes(field: str) -> int:
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines())
    return 1024 * int(status[field].split()[0])


def _children_bytes() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


def found_wrong(folder: Path, numbers: range) -> list[str]:
    """Judge the files of some numbers: what must not happen, by the file; its bytes follow from the number."""
    mutations, wrong, memory = Mutations(folder), [], Memory()
    for number in numbers:
        path = mutations.file(number)
        _, what = judged(path)
        if what:
            wrong.append(f"{path.name}: {what}")
        path.unlink()
    if memory.peak_bytes() > MOST_BYTES:
        wrong.append(f"up to file {numbers[-1]}: {memory.peak_bytes() / 2**30:.2f} GiB of memory")
    return wrong
