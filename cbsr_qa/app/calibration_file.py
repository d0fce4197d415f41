"""Looking at an issued calibration file, and checking it."""

from pathlib import Path
from typing import Any

from cbsr_qa.calibrate.file import read_calibration, verify_calibration
from cbsr_qa.domain.calibration import BaselineConductance, Calibration, SettlingSummary
from cbsr_qa.domain.sensor import Parameter, QuasiStatic


def show_calibration(path: Path) -> dict[str, Any]:
    """Return what a calibration file says, as one JSON document without its arrays.

    Raises
    ------
    CalibrationError
        If the file is not sound; nothing of an unsound file is shown.
    """
    verified = verify_calibration(path)
    calibration = read_calibration(path)
    return {
        "file": str(path),
        "digest": verified.digest,
        "record_digest": verified.record_digest,
        "schema_version": verified.schema_version,
        "identity": _identity(calibration),
        "simulated": list(calibration.simulated),
        "validity": _validity(calibration),
        "baseline_conductance": [_baseline(place) for place in calibration.baseline],
        "against_stress": _quasi_static(calibration.against_stress, "1/kPa"),
        "against_strain": _quasi_static(calibration.against_strain, "1"),
        "assumed": list(calibration.assumed),
        "settling": [_settling(summary) for summary in calibration.settling],
        "area_overlap": {
            "threshold_percent": calibration.overlap_threshold,
            "size_ratio": None if calibration.size_ratio is None else list(calibration.size_ratio),
            "bands": [
                {"name": band.name, "lower_percent": band.lower, "upper_percent": band.upper}
                for band in calibration.overlap_bands
            ],
        },
        "image": _image(calibration),
    }


def verify_file(path: Path) -> dict[str, Any]:
    """Check digest and schema of a calibration file and return what was found.

    Raises
    ------
    CalibrationError
        If the file is not sound, saying what is wrong with it.
    """
    verified = verify_calibration(path)
    return {
        "file": str(path),
        "sound": True,
        "digest": verified.digest,
        "record_digest": verified.record_digest,
        "schema_version": verified.schema_version,
        "datasets": verified.datasets,
    }


def _identity(c: Calibration) -> dict[str, Any]:
    return {
        "calibration": c.calibration,
        "run": c.run,
        "issued_at": c.issued_at,
        "serial": c.sensor.serial,
        "batch": c.sensor.batch,
        "sensor_type": c.sensor.sensor_type,
    }


def _validity(c: Calibration) -> dict[str, Any]:
    return {
        "force_N": None if c.validity.force_N is None else list(c.validity.force_N),
        "strain": list(c.validity.strain),
        "temperature_C": None if c.validity.temperature_C is None else list(c.validity.temperature_C),
        "radius_mm": c.validity.radius_mm,
        "indenter_diameter_mm": c.indenter.diameter_mm,
        "indenter": c.indenter.words(),
        "reduced": list(c.validity.reduced),
    }


def _baseline(place: BaselineConductance) -> dict[str, Any]:
    return {
        "location": place.location,
        "x_mm": place.x_mm,
        "y_mm": place.y_mm,
        "value": place.value,
        "stderr": place.stderr,
        "loads": place.loads,
        "why": place.why,
    }


def _quasi_static(fit: QuasiStatic, slope_units: str) -> dict[str, Any]:
    def parameter(value: Parameter, units: str) -> dict[str, Any]:
        return {"value": value.value, "stderr": value.stderr, "units": units, "source": value.source}

    return {
        "slope": parameter(fit.slope, slope_units),
        "intercept": parameter(fit.intercept, "1"),
        "covariance": fit.covariance,
    }


def _settling(summary: SettlingSummary) -> dict[str, Any]:
    return {
        "signal": summary.signal,
        "direction": "loading" if summary.loading else "unloading",
        "mean_s": summary.mean_s,
        "deviation_s": summary.deviation_s,
        "accepted": summary.accepted,
        "censored": summary.censored,
        "rejected": summary.rejected,
    }


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
