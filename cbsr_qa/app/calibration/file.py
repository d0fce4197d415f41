"""Converting an issued calibration file."""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.firmware import firmware_document
from cbsr_qa.calibration.file.hdf5 import read_in_child, read_issued, require_run_calibration, write_calibration
from cbsr_qa.calibration.file.json import json_document, read_json_calibration
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.report import CommandOutcome
from cbsr_qa.domain.results.signature import fingerprint
from cbsr_qa.report.page import answer
from cbsr_qa.system.files import write_atomically, writing

_JSON: Final = ".json"
_HDF5: Final = (".h5", ".hdf5")


@dataclass(frozen=True, slots=True)
class Converted:
    """The file that was written.

    Parameters
    ----------
    digest : SHA-256 of the content; for a firmware file, of its calibration.
    loss : what a firmware file omits; None if it omits nothing.
    signed_by : fingerprint of the key whose signature it has; None if it has none, as a firmware file.
    """

    file: Path
    output: Path
    size_bytes: int
    digest: str
    loss: dict[str, Any] | None
    signed_by: str | None


def export_calibration(
    source: Path, output: Path, *, firmware: bool = False, stride: int | None = None
) -> CommandOutcome[Converted]:
    """Convert a calibration: HDF5 to JSON or back without loss, or to small JSON for firmware.

    Parameters
    ----------
    source, output : files; the suffix, .h5, .hdf5 or .json, says which kind.
    stride : stride of the lattice for firmware, see :func:`~cbsr_qa.calibration.file.firmware.firmware_document`.

    Raises
    ------
    CalibrationError
        If the source is damaged, or firmware is requested and it has no force model.
    RefusedError
        If the output exists already, cannot be written, or has another suffix.
    """
    kind = output.suffix.lower()
    if kind not in (_JSON, *_HDF5):
        raise RefusedError(f"{output} has an unknown suffix", remedy="use .json or .h5")
    if firmware and kind != _JSON:
        raise RefusedError(f"firmware takes JSON, not {output.suffix}", remedy="use .json")
    check_free(output)
    calibration = read_any(source)
    loss = None
    if kind in _HDF5:
        write_calibration(output, calibration)
    elif firmware:
        document = firmware_document(require_run_calibration(calibration), stride=stride)
        loss = {"lattice_stride": document["lattice_stride"], **document["loss"]}
        write_text(output, _json(document))
    else:
        write_json(output, calibration)
    signature = None if firmware else calibration.signature
    signed_by = None if signature is None else fingerprint(signature.public_key)
    converted = Converted(source, output, output.stat().st_size, calibration.digest, loss, signed_by)
    if loss is None:
        facts = [("SHA-256", f"{converted.digest}, as before")]
    else:
        rms, worst = loss["relative_force_error_rms"], loss["relative_force_error_worst"]
        forces = f"at {loss['places']} calibrated places forces differ by {rms:.2%} rms and {worst:.2%} at most"
        facts = [("Lattice", f"every {loss['lattice_stride']}th node"), ("Loss", forces)]
        facts.append(("Places lost", str(loss["places_lost"])))
    if calibration.signature is not None:
        kept = "lost: a firmware file has none" if firmware else f"by {calibration.signature.words}, as before"
        facts.append(("Signature", kept))
    return answer(converted, "written", f"{converted.size_bytes / 1e3:.0f} kB", facts, [("File", str(output))])


def read_any(path: Path) -> Issued:
    """Read a calibration of unknown origin, HDF5 or JSON by its suffix, in a limited child process.

    Raises
    ------
    CalibrationError
        If the file is damaged, or cannot be read within the limits.
    """
    read = read_json_calibration if is_json(path) else read_issued
    return read_in_child(path, partial(read, path))


def is_json(path: Path) -> bool:
    """Whether a calibration is JSON, by its suffix."""
    return path.suffix.lower() == _JSON


def write_json(path: Path, calibration: Issued) -> None:
    """Write a calibration as JSON, whole or not at all. Raise RefusedError if it cannot be written."""
    write_text(path, _json(json_document(calibration)))


def _json(document: dict[str, Any]) -> str:
    return json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"


def check_free(output: Path) -> None:
    """Make sure that a file does not exist yet. Raise RefusedError if it does, or its path cannot be used."""
    with writing(output):
        taken = output.is_symlink() or output.exists()
    if taken:
        raise RefusedError(f"{output} exists already", remedy="name another file, or remove it first")


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all. Raise RefusedError if it cannot be written."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            file.write(text.encode())
