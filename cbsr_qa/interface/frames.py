"""Frames as arrays, as datasets, and as the program keeps them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.app.export.frames import frames_of
from cbsr_qa.app.export.netcdf import Variable, frame_variables
from cbsr_qa.config.loader import load_scanned_type, load_sensor_type
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import real_numbers
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, Recording, VoltageUnit
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.interface.tables import notebook_library

if TYPE_CHECKING:
    import xarray as xr

#: Frames (n, drives, measures) or (drives, measures), NaN where a reading is missing; or a dataset of this package.
Frames: TypeAlias = "ArrayLike | xr.Dataset | FrameBlock"


def dataset_of(variables: Sequence[Variable], attributes: Mapping[str, Any]) -> "xr.Dataset":
    """Return the content of an exported netCDF file as a dataset."""
    xarray = notebook_library("xarray", "a dataset of frames")
    beside = {name for v in variables for name in str(v.more.get("coordinates", "")).split()}
    values: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    for variable in variables:
        own = {key: value for key, value in variable.more.items() if key not in ("coordinates", "_FillValue")}
        about = {"long_name": variable.long_name, **({"units": variable.units} if variable.units else {}), **own}
        place = coordinates if variable.name in beside or variable.dimensions == (variable.name,) else values
        place[variable.name] = (variable.dimensions, variable.values, about)
    dataset: xr.Dataset = xarray.Dataset(values, coordinates, attributes)
    return dataset


def recording_dataset(recording: Recording, sensor_type: SensorType, name: str) -> "xr.Dataset":
    """Return the frames of a recording as a dataset with one phase."""
    frames = frames_of([(name, recording.frames, recording.loads)])
    simulated = "simulated: " + "; ".join(recording.simulated) if recording.simulated else "measured"
    attributes = {"title": f"Frames of {name}", "source": simulated, "sensor_type": sensor_type.name}
    return dataset_of(frame_variables(sensor_type, frames, recording.samples), attributes)


def frame_block(frames: Frames, *, time_s: ArrayLike | None = None, current_A: float | None = None) -> FrameBlock:
    """Return frames as the program keeps them.

    Parameters
    ----------
    frames : an array in volts; of a dataset its variables voltage, flags, time and current.
    time_s : (n,) time of each frame [s]; by default that of the dataset, else frames are a second apart.
    current_A : drive current [A]; by default that of the dataset, else not known.

    Raises
    ------
    RefusedError
        If shapes or values are not those of frames.
    """
    if isinstance(frames, FrameBlock):
        return frames
    if hasattr(frames, "data_vars"):
        return _read_dataset(cast("xr.Dataset", frames), time_s, current_A)
    voltages = real_numbers(frames, "frames")
    return _block(voltages, np.zeros(voltages.shape, np.uint8), time_s, current_A)


def _read_dataset(frames: "xr.Dataset", time_s: ArrayLike | None, current_A: float | None) -> FrameBlock:
    if "voltage" not in frames:
        raise RefusedError(
            f"a dataset without the variable voltage: it has {', '.join(map(str, frames.data_vars)) or 'none'}",
            remedy="give one of Run.frames or Scene.frames, or an array",
        )
    unit = frames["voltage"].attrs.get("units", VoltageUnit.VOLT.value)
    if unit not in list(VoltageUnit):
        raise RefusedError(f"the frames of this dataset are in {unit}", remedy=f"give {' or '.join(VoltageUnit)}")
    ordered = [name for name in ("time", "drive", "measure") if name in frames["voltage"].dims]
    voltages = frames["voltage"].transpose(*ordered).values
    flags = frames["flags"].transpose(*ordered).values if "flags" in frames else np.zeros(voltages.shape, np.uint8)
    if time_s is None and "time" in frames["voltage"].coords:
        time_s = frames["time"].values
    if current_A is None and "current" in frames["voltage"].coords:
        stated = np.unique(frames["current"].values)
        if len(stated) > 1:
            raise RefusedError("these frames differ in their drive current", remedy="select those of one phase")
        current_A = None if np.isnan(stated[0]) else float(stated[0])
    block = _block(np.asarray(voltages, np.float64), np.asarray(flags, np.uint8), time_s, current_A)
    return replace(block, unit=VoltageUnit(unit))


def _block(
    voltages: np.ndarray[Any, np.dtype[np.float64]],
    flags: np.ndarray[Any, np.dtype[np.uint8]],
    time_s: ArrayLike | None,
    current_A: float | None,
) -> FrameBlock:
    if voltages.ndim == 2:
        voltages, flags = voltages[None], flags[None]
    if voltages.ndim != 3 or not voltages.size:
        raise RefusedError(
            f"frames of the shape {voltages.shape}", remedy="give an array (frames, drive pairs, measure pairs)"
        )
    missing = np.isnan(voltages)
    flags = np.where(missing, flags | ReadingFlag.MISSING.value, flags).astype(np.uint8)
    times = np.arange(len(voltages), dtype=np.float64) if time_s is None else real_numbers(time_s, "times")
    times = np.atleast_1d(times)
    if times.shape != voltages.shape[:1]:
        raise RefusedError(f"{times.size} times for {len(voltages)} frames", remedy="give one time for each frame")
    return FrameBlock(times, np.where(missing, 0.0, voltages), flags, VoltageUnit.VOLT, current_A)


def sensor_type_of(
    frames: Frames, sensor_type: str | Path | SensorType | None, *, scanned: bool = False
) -> SensorType:
    """Return a sensor type; by default the one that a dataset names. RefusedError if nothing names one.

    Parameters
    ----------
    scanned : whether the readings bring their pattern, so that the one of a file does not matter.
    """
    if isinstance(sensor_type, SensorType):
        return sensor_type
    named = getattr(frames, "attrs", {}).get("sensor_type") if sensor_type is None else str(sensor_type)
    if named is None:
        raise RefusedError(
            "an array does not state its sensor type", remedy='give one, e.g. sensor_type="disc-100mm"'
        )
    return (load_scanned_type if scanned else load_sensor_type)(named).value
