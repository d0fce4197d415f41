"""Frames of a run for EIDORS: a MATLAB file of version 5, which Octave and scipy read too."""

from collections.abc import Mapping
from typing import Any, BinaryIO, Final, cast

import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.sparse import csc_array

from cbsr_qa.app.export.frames import LoadStage, RunFrames
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.run.run import RunRecord

#: Size that a variable of this version of the format must stay below [bytes].
_LARGEST: Final = 2**31


def write_eidors(file: BinaryIO, record: RunRecord, frames: RunFrames, attributes: Mapping[str, str | float]) -> None:
    """Write the frames with the stimulation that EIDORS needs, and what was going on at each frame (``cbsr``).

    ``vv`` holds all readings, index measures·drive + measure; ``fmdl.stimulation`` those that touch no driven
    electrode, which ``fmdl.meas_select`` selects from ``vv``, as ``mk_stim_patterns`` returns both.

    Parameters
    ----------
    attributes : attributes of the run.

    Raises
    ------
    RefusedError
        If the drive current is not the same for all frames, or there are more than the format holds.
    """
    current_A = np.unique(frames.current_A)  # NaN counts as one value
    if len(current_A) > 1:
        raise RefusedError(
            "phases of this run differ in their drive current, and EIDORS knows one",
            remedy="export one phase at a time with --phase",
        )
    if frames.frames.voltages.nbytes >= _LARGEST:
        raise RefusedError(
            f"{len(frames.frames)} frames are more than a MATLAB file of version 5 holds",
            remedy="export one phase at a time with --phase, or netCDF (.nc)",
        )
    content = {
        "vv": _vectors(frames.readings),
        "fmdl": _model(record, float(current_A[0])),
        "cbsr": _metadata_fields(record, frames, attributes, float(current_A[0])),
    }
    savemat(cast(Any, file), content, do_compression=True, long_field_names=True, oned_as="row")


def _vectors(values: NDArray[Any]) -> NDArray[Any]:
    """Return frames (n, drives, measures) as columns (drives · measures, n)."""
    return np.ascontiguousarray(values.reshape(len(values), -1).T)


def _model(record: RunRecord, current_A: float) -> dict[str, Any]:
    pattern = record.sensor_type.pattern
    currents = pattern.drive_currents() * (1.0 if np.isnan(current_A) else current_A)
    voltages, usable_mask = pattern.measure_matrix().T, pattern.usable()
    fields = ("stimulation", "stim_pattern", "meas_pattern")
    stimulation = np.empty((1, len(usable_mask)), dtype=[(name, object) for name in fields])
    for drive, used_mask in enumerate(usable_mask):
        stimulation[0, drive] = ("Amp", csc_array(currents[:, [drive]]), csc_array(voltages[used_mask]))
    return {
        "type": "fwd_model",
        "name": record.sensor_type.name,
        "stimulation": stimulation,
        "meas_select": usable_mask.reshape(-1, 1),
    }


def _metadata_fields(
    record: RunRecord, frames: RunFrames, attributes: Mapping[str, str | float], current_A: float
) -> dict[str, Any]:
    electrodes, polygon = record.sensor_type.electrodes, record.sensor_type.polygon
    corners_mm = np.array(() if polygon is None else polygon.corners_mm).reshape(-1, 2)
    return {
        **attributes,
        "unit": str(frames.frames.unit),
        "current_A": current_A,
        "electrode_positions_mm": electrodes.positions_mm(),
        "electrode_width_mm": electrodes.width_mm,
        "sheet_radius_mm": record.sensor_type.radius_mm,
        "sheet_corners_mm": corners_mm,
        "time_s": frames.frames.time_s,
        "flags": _vectors(frames.frames.flags),
        "phases": np.array(frames.phases, dtype=object),
        "phase": frames.phase + 1,  # MATLAB counts from 1
        "load_stages": np.array([stage.name.lower() for stage in LoadStage], dtype=object),
        "load_stage": frames.stage,
        "load_label": frames.load_values("label"),
        "load_x_mm": frames.load_values("x_mm"),
        "load_y_mm": frames.load_values("y_mm"),
        "strain": frames.strain,
    }
