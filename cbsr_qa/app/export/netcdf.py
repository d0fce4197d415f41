"""Frames of a run as netCDF-4, by the CF conventions: xarray, MATLAB and netCDF's own tools open it without help.

A netCDF-4 file is an HDF5 file whose dimensions are HDF5 dimension scales; h5py writes them.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from cbsr_qa.app.export.frames import LoadStage, RunFrames
from cbsr_qa.domain.readings.frames import ReadingFlag, SampleBlock
from cbsr_qa.domain.sensor.sensor_type import SensorType

#: Values of a variable that are packed together; whole frames go together.
_CHUNK_VALUES: Final = 1 << 16


class Variable(NamedTuple):
    """A variable: its values (object: texts), and what they are."""

    name: str
    dimensions: tuple[str, ...]
    values: NDArray[Any]
    long_name: str
    units: str = ""
    more: Mapping[str, Any] = {}


def frame_variables(
    sensor_type: SensorType, frames: RunFrames, samples: Sequence[SampleBlock]
) -> tuple[Variable, ...]:
    """Return the variables of frames: readings, events, pairs and electrodes, and the samples of other channels."""
    coordinates = [*_time_variables(frames), *_pattern_variables(sensor_type)]
    coordinate_names = " ".join(variable.name for variable in coordinates)
    electrodes = [
        Variable(
            f"electrode_{axis}", ("electrode",), np.ascontiguousarray(place_mm), "place from the sheet's centre", "mm"
        )
        for axis, place_mm in zip("xy", sensor_type.electrodes.positions_mm().T, strict=True)
    ]
    variables = [
        *_dimensions(sensor_type, frames),
        *coordinates,
        *_readings(frames, coordinate_names),
        *electrodes,
    ]
    names_taken = {variable.name for variable in variables}
    for block in samples:
        variables += _samples(block, names_taken)
    return tuple(variables)


def netcdf_file(variables: Sequence[Variable], attributes: Mapping[str, str | float]) -> bytes:
    """Return the content of the file; ``attributes`` are those of the file as a whole."""
    # Built in memory: HDF5 prints tracebacks when a disk is full, and cannot close its file.
    with h5py.File("frames.nc", "w", driver="core", backing_store=False, track_order=True) as file:
        file.attrs.update({"Conventions": "CF-1.11", **attributes})
        for variable in sorted(variables, key=lambda variable: variable.dimensions != (variable.name,)):
            _write(file, variable)
        file.flush()
        return bytes(file.id.get_file_image())


def _dimensions(sensor_type: SensorType, frames: RunFrames) -> Iterator[Variable]:
    yield Variable("time", ("time",), frames.frames.time_s, "middle of the frame, on the run's clock", "s")
    drives, measures = frames.frames.voltages.shape[1:]
    yield Variable("drive", ("drive",), np.arange(drives, dtype=np.int32), "drive pair")
    yield Variable("measure", ("measure",), np.arange(measures, dtype=np.int32), "measure pair")
    count = sensor_type.electrodes.count
    yield Variable("electrode", ("electrode",), np.arange(count, dtype=np.int32), "electrode")


def _readings(frames: RunFrames, coordinates: str) -> Iterator[Variable]:
    dimensions = ("time", "drive", "measure")
    attributes = {"coordinates": coordinates}
    unit = str(frames.frames.unit)
    readings = {**attributes, "ancillary_variables": "flags", "_FillValue": np.nan}
    yield Variable(
        "voltage", dimensions, frames.readings, "reading: potential at plus less that at minus", unit, readings
    )
    flags = {
        "flag_masks": np.array([flag.value for flag in ReadingFlag if flag], dtype=np.uint8),
        "flag_meanings": " ".join(str(flag.name).lower() for flag in ReadingFlag if flag),
    }
    yield Variable("flags", dimensions, frames.frames.flags, "faults of the reading", "", {**attributes, **flags})


def _time_variables(frames: RunFrames) -> Iterator[Variable]:
    dimensions = ("time",)
    yield Variable("phase", dimensions, np.array(frames.phases, dtype=object)[frames.phase], "phase of the run")
    stages = {
        "flag_values": np.array([stage.value for stage in LoadStage], dtype=np.uint8),
        "flag_meanings": " ".join(stage.name.lower() for stage in LoadStage),
    }
    yield Variable("load_stage", dimensions, frames.stage, "what the head was doing", "", stages)
    yield Variable("load_label", dimensions, frames.load_values("label"), "label of the press in progress")
    yield Variable("load_trial", dimensions, frames.load_values("trial"), "repetition of the press, from 0", "1")
    yield Variable(
        "load_x", dimensions, frames.load_values("x_mm"), "place of the press from the sheet's centre", "mm"
    )
    yield Variable(
        "load_y", dimensions, frames.load_values("y_mm"), "place of the press from the sheet's centre", "mm"
    )
    yield Variable("strain", dimensions, frames.strain, "compressive strain while it is held", "1")
    yield Variable("current", dimensions, frames.current_A, "drive current", "A")
    if frames.frames.reading_time_s is not None:
        reading_times_s = frames.frames.reading_time_s
        yield Variable(
            "reading_time",
            ("time", "drive", "measure"),
            reading_times_s,
            "time of the reading, on the run's clock",
            "s",
        )


def _pattern_variables(sensor_type: SensorType) -> Iterator[Variable]:
    pattern = sensor_type.pattern
    drive, measure = np.array(pattern.drive, dtype=np.int32), np.array(pattern.measure, dtype=np.int32)
    yield Variable("drive_source", ("drive",), drive[:, 0], "electrode at which current flows in")
    yield Variable("drive_sink", ("drive",), drive[:, 1], "electrode at which current flows out")
    yield Variable("measure_plus", ("measure",), measure[:, 0], "positive electrode of the reading")
    yield Variable("measure_minus", ("measure",), measure[:, 1], "negative electrode of the reading")
    usable = pattern.usable().astype(np.uint8)
    yield Variable("usable", ("drive", "measure"), usable, "1: the reading touches no driven electrode")


def _samples(block: SampleBlock, taken: set[str]) -> Iterator[Variable]:
    """Yield a channel and its own times, under names that are free."""
    name = re.sub(r"\W+", "_", block.channel, flags=re.ASCII).strip("_") or "channel"
    while {name, f"{name}_time"} & taken:
        name += "_"
    dimensions = (f"{name}_time",)
    taken |= {name, *dimensions}
    yield Variable(dimensions[0], dimensions, block.time_s, f"time of {block.channel}, on the run's clock", "s")
    yield Variable(name, dimensions, block.values, block.channel, block.unit)


def _write(file: h5py.File, variable: Variable) -> None:
    name, dimensions, values, long_name, units, attributes = variable
    if values.dtype == object:
        data = file.create_dataset(name, data=values, dtype=h5py.string_dtype(), track_order=True)
    else:
        frame = int(np.prod(values.shape[1:])) or 1
        chunks = (max(1, min(len(values), _CHUNK_VALUES // frame)), *values.shape[1:])
        packed = {"chunks": chunks, "compression": "gzip", "compression_opts": 4, "shuffle": True}
        data = file.create_dataset(name, data=values, track_order=True, **(packed if values.size else {}))
    data.attrs.update({"long_name": long_name, **({"units": units} if units else {}), **attributes})
    if dimensions == (name,):
        data.make_scale(name)
        return
    for axis, dimension in enumerate(dimensions):
        data.dims[axis].attach_scale(file[dimension])
