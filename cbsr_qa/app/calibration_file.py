"""Looking at an issued calibration file, checking it, and converting it."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from cbsr_qa.calibration.file import (
    firmware_document,
    json_document,
    read_calibration,
    read_json_calibration,
    verify_calibration_file,
    write_calibration,
)
from cbsr_qa.calibration.runtime import ForceInverse, TemplateFilter, interpolated, least_force_N, map_tables
from cbsr_qa.domain import CalibrationError, RefusedError, kept_fields
from cbsr_qa.domain.results import Calibration, ForceModel, SettlingSummary
from cbsr_qa.domain.sensor import QuasiStatic
from cbsr_qa.system import read_untrusted, written_whole

_JSON: Final = ".json"
_HDF5: Final = (".h5", ".hdf5")


def show_calibration(path: Path) -> dict[str, Any]:
    """Return what a calibration file says, as one JSON document without its arrays.

    Raises
    ------
    CalibrationError
        If the file is not sound; nothing of an unsound file is shown.
    """
    verified, calibration = read_untrusted(
        path, lambda: (verify_calibration_file(path), read_calibration(path)), refusal=CalibrationError
    )
    return {
        "file": str(path),
        "digest": verified.digest,
        "record_digest": verified.record_digest,
        "schema_version": verified.schema_version,
        "identity": {
            "calibration": calibration.calibration,
            "run": calibration.run,
            "issued_at": calibration.issued_at,
            **asdict(calibration.sensor),
        },
        "simulated": calibration.simulated,
        "validity": {
            **asdict(calibration.validity),
            "indenter_diameter_mm": calibration.indenter.diameter_mm,
            "indenter": calibration.indenter.words(),
        },
        "baseline_conductance": [asdict(place) for place in calibration.baseline],
        "against_stress": _quasi_static(calibration.against_stress, "1/kPa"),
        "against_strain": _quasi_static(calibration.against_strain, "1"),
        "assumed": calibration.assumed,
        "settling": [_settling(summary) for summary in calibration.settling],
        "area_overlap": {
            "threshold_percent": calibration.overlap_threshold,
            "size_ratio": calibration.size_ratio,
            "bands": [
                {"name": band.name, "lower_percent": band.lower, "upper_percent": band.upper}
                for band in calibration.overlap_bands
            ],
        },
        "image": _image(calibration),
        "values": _values(calibration),
        "force_model": _force(calibration),
        "no_force_model": _no_force(calibration),
    }


@dataclass(frozen=True, slots=True)
class Converted:
    """What was written.

    Parameters
    ----------
    file, output : what was converted, and into what.
    size_bytes : of what was written.
    digest : of the content; for firmware that of the calibration it is from.
    loss : what a firmware file loses, as it says itself; None for a conversion without loss.
    """

    file: Path
    output: Path
    size_bytes: int
    digest: str
    loss: dict[str, Any] | None

    def document(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        return {**asdict(self), "file": str(self.file), "output": str(self.output)}


def export_calibration(source: Path, output: Path, *, firmware: bool = False, stride: int | None = None) -> Converted:
    """Convert a calibration: HDF5 to JSON or back without loss, or to small JSON for firmware.

    Parameters
    ----------
    source, output : files; what they are is said by their suffixes, .h5 (or .hdf5) and .json.
    firmware : write the small JSON.
    stride : of its lattice, see :func:`~cbsr_qa.calibration.file.firmware_document`.

    Raises
    ------
    CalibrationError
        If the source is not sound, or holds no force model and firmware is asked for.
    RefusedError
        If the output exists already, cannot be written, or has another suffix.
    """
    kind = output.suffix.lower()
    if kind not in (_JSON, *_HDF5):
        raise RefusedError(f"{output} says not by its suffix what to write", remedy="name a file .json or .h5")
    if firmware and kind != _JSON:
        raise RefusedError(f"firmware takes JSON, not {output.suffix}", remedy="name a file .json")
    _check_free(output)
    calibration = read_any(source)
    loss = None
    if kind in _HDF5:
        write_calibration(output, calibration)
    elif firmware:
        document = firmware_document(calibration, stride=stride)
        loss = {"lattice_stride": document["lattice_stride"], **document["loss"]}
        _write_json(output, document)
    else:
        _write_json(output, json_document(calibration))
    return Converted(source, output, output.stat().st_size, calibration.digest, loss)


def read_any(path: Path) -> Calibration:
    """Read a calibration of unknown origin, HDF5 or JSON by its suffix, in a limited child process.

    Raises
    ------
    CalibrationError
        If the file is not sound, or cannot be read within the limits.
    """
    read = read_json_calibration if path.suffix.lower() == _JSON else read_calibration
    return read_untrusted(path, lambda: read(path), refusal=CalibrationError)


def _check_free(output: Path) -> None:
    try:
        taken = output.is_symlink() or output.exists()
    except OSError as error:
        raise RefusedError(f"{output} cannot be written: {error.strerror or error}") from error
    if taken:
        raise RefusedError(f"{output} exists already", remedy="name another file, or remove it first")


def _write_json(path: Path, document: dict[str, Any]) -> None:
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")) + "\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as file:
            file.write(text.encode())
    except FileExistsError as error:
        raise RefusedError(f"{path} cannot be written: {error.filename} is a file, not a folder") from error
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error


def verify_file(path: Path) -> dict[str, Any]:
    """Check digest and schema of a calibration file and return what was found.

    Raises
    ------
    CalibrationError
        If the file is not sound, saying what is wrong with it.
    """
    verified = read_untrusted(path, lambda: verify_calibration_file(path), refusal=CalibrationError)
    return {
        "file": str(path),
        "sound": True,
        "digest": verified.digest,
        "record_digest": verified.record_digest,
        "schema_version": verified.schema_version,
        "datasets": verified.datasets,
        "bytes_checked": verified.bytes_checked,
    }


def _no_force(c: Calibration) -> str | None:
    if c.force is not None:
        return None
    return c.no_force or "issued before calibrations held force models"


def _force(c: Calibration) -> dict[str, Any] | None:
    """The force model in numbers: its map over the calibrated places, and the least force it detects."""
    if c.force is None:
        return None
    model = c.force
    places = _places(c, model)
    response = np.exp(interpolated(model, model.log_response, places))
    stderr = interpolated(model, model.log_response_stderr, places)
    least = _least_force_N(c, model, places)
    centre = int(np.argmin(np.hypot(*places.T)))
    worst = int(np.argmax(least))
    return {
        "places": len(places),
        "lattice_spacing_mm": model.lattice.spacing_mm,
        "response_lowest": float(response.min()),
        "response_highest": float(response.max()),
        "response_stderr_lowest": float(stderr.min()),
        "response_stderr_highest": float(stderr.max()),
        "scatter": model.scatter,
        "stress_kPa": list(model.stress_kPa),
        "hold_s": model.steady_s,
        "threshold": model.threshold,
        "least_force_centre_N": float(least[centre]),
        "least_force_worst_N": float(least[worst]),
        "least_force_worst_at_mm": [float(places[worst, 0]), float(places[worst, 1])],
        "head": c.indenter.words(),
        "assumed": [name for name in c.assumed if name.endswith("stress")],
    }


def _places(c: Calibration, model: ForceModel) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Nodes of the lattice where the head may be, within the calibrated radius; all, where none is that near."""
    everywhere, node = model.lattice.places_mm(), model.node.ravel()
    fits = np.where(node >= 0, model.fits[node], False)
    fits &= np.isfinite(TemplateFilter(model).template(everywhere)).all(axis=1)
    near = fits & (np.hypot(*everywhere.T) <= c.validity.radius_mm)
    return everywhere[near if near.any() else fits]


def _least_force_N(
    c: Calibration, model: ForceModel, places: np.ndarray[Any, np.dtype[np.float64]]
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Force at each place whose change of one frame just counts as a load (its detectability is the threshold)."""
    inverse = ForceInverse(model, c.against_stress, c.indenter.area_mm2, map_tables(model))
    return least_force_N(inverse, np.linalg.norm(TemplateFilter(model).template(places), axis=1), places)


def _values(c: Calibration) -> dict[str, dict[str, Any]]:
    """Return every single number of a calibration itself, by its path in the file."""
    numbers = (field for field in kept_fields(Calibration) if field.hint in (float, float | None))
    return {field.path(""): {"value": getattr(c, field.name), "units": field.units("1", "1")} for field in numbers}


def _quasi_static(fit: QuasiStatic, slope_units: str) -> dict[str, Any]:
    return {
        "slope": {**asdict(fit.slope), "units": slope_units},
        "intercept": {**asdict(fit.intercept), "units": "1"},
        "covariance": fit.covariance,
    }


def _settling(summary: SettlingSummary) -> dict[str, Any]:
    said = asdict(summary)
    return {"signal": said.pop("signal"), "direction": "loading" if said.pop("loading") else "unloading", **said}


def _image(c: Calibration) -> dict[str, Any]:
    problem = c.reconstruction.problem
    return {
        "method": c.reconstruction.method,
        "regularisation": c.reconstruction.choice.value,
        "regularisation_name": c.reconstruction.choice.name,
        "regularisation_criterion": c.reconstruction.choice.criterion or None,
        "regularisation_how": c.reconstruction.choice.how,
        "noise_figure_nominal": c.reconstruction.choice.noise_figure,
        "noise_figure_measured": c.noise_figure,
        "elements": len(problem.mesh.elements),
        "readings": int(problem.used.sum()),
        "response": c.response.value,
        "noise_floor": c.noise_floor,
        "mask": c.mask,
        "current_A": c.current_A,
    }
