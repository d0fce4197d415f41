"""Calibrations as programs up to schema 0011 stored them: in rows, without their file."""

import hashlib
from datetime import datetime

import numpy as np

from cbsr_qa.store.chain.links import add_rows
from cbsr_qa.store.engine import writing
from cbsr_qa.store.runs.codec import encode_setting
from cbsr_qa.store.tables.results import (
    BaselineRow,
    CalibrationRow,
    FitParameterRow,
    ForceRow,
    OverlapBandRow,
    RelaxationRow,
    SettlingRow,
)

_PARAMETERS = (
    ("against_stress.slope", "1/kPa", "α against stress"),
    ("against_stress.intercept", "1", "β against stress"),
    ("against_strain.slope", "1", "α against strain"),
    ("against_strain.intercept", "1", "β against strain"),
)
_NUMBERS = (
    *("scatter", "threshold", "misfit", "residue_share", "residue_stderr", "residue_strength", "steady_s"),
    "place_scatter_mm",
)


def store_as_rows(repository, calibration, analysis):
    """Store a calibration with an analysis that was stored without one."""
    run, name = calibration.run, {"calibration": calibration.calibration}
    with writing(repository._engine) as connection:
        add_rows(connection, run, CalibrationRow, [_values(calibration, analysis)])
        for table, rows in list_rows(calibration):
            add_rows(connection, run, table, [name | row for row in rows])
        if calibration.force is not None:
            add_rows(connection, run, ForceRow, [name | force_values(calibration.force)])


def packed(values):
    return np.ascontiguousarray(values, dtype="<f8").tobytes()


def packed_flags(values):
    return np.ascontiguousarray(values, dtype=np.uint8).tobytes()


def digest(header, parts):
    total = hashlib.sha256(header.encode())
    for part in parts:
        total.update(len(part).to_bytes(8, "little") + part)
    return total.hexdigest()


def list_rows(calibration):
    """Yield every table with the rows a calibration has in it, its name left out."""
    yield BaselineRow, _numbered(map(_baseline_values, calibration.baseline))
    yield SettlingRow, _numbered(map(_settling_values, calibration.settling))
    yield RelaxationRow, _numbered(map(_relaxation_values, calibration.relaxations))
    yield OverlapBandRow, _numbered(map(_band_values, calibration.overlap_bands))
    yield FitParameterRow, [_parameter_values(calibration, *parameter) for parameter in _PARAMETERS]


def _numbered(rows):
    return [{"number": number, **row} for number, row in enumerate(rows)]


def _baseline_values(place):
    return {
        "location": place.location,
        "x_mm": place.x_mm,
        "y_mm": place.y_mm,
        "value": place.value,
        "stderr": place.stderr,
        "loads": place.loads,
        "why": place.why,
    }


def _settling_values(summary):
    return {
        "signal": summary.signal,
        "loading": bool(summary.loading),
        "mean_s": summary.mean_s,
        "deviation_s": summary.deviation_s,
        "accepted": summary.accepted,
        "censored": summary.censored,
        "rejected": summary.rejected,
    }


def _relaxation_values(relaxation):
    fit, settled = relaxation.fit, relaxation.settling
    first, second = _two(fit.amplitudes)
    fast_s, slow_s = _two(fit.time_constants_s)
    fast_stderr_s, slow_stderr_s = _two(fit.time_constant_stderr_s)
    return {
        "phase": relaxation.phase,
        "load_index": relaxation.load,
        "location": relaxation.location,
        "trial": relaxation.trial,
        "strain": relaxation.strain,
        "signal": relaxation.signal,
        "unit": relaxation.unit,
        "loading": bool(relaxation.loading),
        "status": str(fit.status),
        "level": fit.offset,
        "level_stderr": fit.offset_stderr,
        "amplitude_1": first,
        "amplitude_2": second,
        "time_constant_1_s": fast_s,
        "time_constant_2_s": slow_s,
        "time_constant_1_stderr_s": fast_stderr_s,
        "time_constant_2_stderr_s": slow_stderr_s,
        "r_squared": fit.r_squared,
        "why": fit.why,
        "settling_s": settled.value_s,
        "settling_censored": bool(settled.censored),
        "settling_band": settled.band,
        "settling_why": settled.why,
    }


def _two(values):
    """At most two numbers, with None where there is none."""
    first, second = (*values, None, None)[:2]
    return first, second


def _band_values(band):
    return {"name": band.name, "lower_percent": band.lower, "upper_percent": band.upper}


def _parameter_values(calibration, name, unit, called):
    fit, which = name.split(".")
    parameter = getattr(getattr(calibration, fit), which)
    return {
        "name": name,
        "value": parameter.value,
        "stderr": parameter.stderr,
        "unit": unit,
        "source": parameter.source,
        "assumed": called in calibration.assumed,
    }


def force_values(model):
    """Return the row of a model, its calibration left out."""
    merged, readings = model.merging.shape
    arrays = [packed(values + 0.0) for values in (model.merging, model.log_response, model.log_response_stderr)]
    return {
        "merged": merged,
        "readings": readings,
        "merging": arrays[0],
        "nodes": len(model.log_response),
        "log_response": arrays[1],
        "log_response_stderr": arrays[2],
        "force_sha256": digest(f"{merged}x{readings}|1/V|{len(model.log_response)}", arrays),
        "stress_low_kpa": model.stress_kPa[0],
        "stress_high_kpa": model.stress_kPa[1],
        **{name: getattr(model, name) for name in _NUMBERS},
        "kernels": {
            name: _kernel_values(kernel)
            for name, kernel in (("loading", model.loading), ("unloading", model.unloading))
            if kernel is not None
        },
    }


def _kernel_values(kernel):
    return {
        "weights": kernel.weights.tolist(),
        "time_constants_s": kernel.time_constants_s.tolist(),
        "covariance": kernel.covariance.tolist(),
        "scatter": kernel.scatter.tolist(),
        "scatter_freedom": float(kernel.scatter_freedom),
        "loads": int(kernel.loads),
        "start_s": float(kernel.start_s),
        "why": kernel.why,
    }


def _values(calibration, analysis):
    size_ratio = calibration.size_ratio or (None, None)
    return {
        "calibration": calibration.calibration,
        "run": calibration.run,
        "analysis": analysis,
        "serial": calibration.sensor.serial,
        "issued_at": datetime.fromisoformat(calibration.issued_at),
        "response": str(calibration.response),
        "current_a": calibration.current_A,
        "scale": calibration.scale,
        "noise_floor": calibration.noise_floor,
        "mask": calibration.mask,
        "measured_noise_figure": calibration.noise_figure,
        **_imaging_values(calibration.reconstruction, calibration.reference),
        "no_force": calibration.no_force,
        "overlap_threshold": calibration.overlap_threshold,
        "size_ratio_low": size_ratio[0],
        "size_ratio_high": size_ratio[1],
        "stress_covariance": calibration.against_stress.covariance,
        "strain_covariance": calibration.against_strain.covariance,
        **_validity_values(calibration.validity),
        "assumed": list(calibration.assumed),
        "simulated": list(calibration.simulated),
        "setting": encode_setting(calibration.sensor_type, calibration.indenter),
        "content_sha256": calibration.digest,
        "record_sha256": calibration.record_digest,
    }


def _imaging_values(reconstruction, reference):
    drives, measures = reference.shape
    frame, used = packed(reference), packed_flags(reconstruction.problem.used.astype("uint8"))
    return {
        "method": reconstruction.method,
        "regularisation": reconstruction.choice.value,
        "regularisation_name": reconstruction.choice.name,
        "regularisation_criterion": reconstruction.choice.criterion,
        "regularisation_how": reconstruction.choice.how,
        "noise_figure": reconstruction.choice.noise_figure,
        "drives": drives,
        "measures": measures,
        "reference": frame,
        "used": used,
        "reference_sha256": digest(f"{drives}x{measures}|V", (frame, used)),
    }


def _validity_values(validity):
    force_N, temperature_C = validity.force_N or (None, None), validity.temperature_C or (None, None)
    return {
        "force_low_n": force_N[0],
        "force_high_n": force_N[1],
        "strain_low": validity.strain[0],
        "strain_high": validity.strain[1],
        "temperature_low_c": temperature_C[0],
        "temperature_high_c": temperature_C[1],
        "radius_mm": validity.radius_mm,
        "reduced": list(validity.reduced),
    }
