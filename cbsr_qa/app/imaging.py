"""Frames imaged by any reconstruction: without a run, events or metrics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Final

import numpy as np
from pydantic import Field, InstanceOf

from cbsr_qa.analysis.recording.analysis import DEFAULT_RECONSTRUCTION
from cbsr_qa.analysis.recording.imaging import difference_model
from cbsr_qa.calibration.presses.frame_tables import find_other_unit
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import Image, PreparedReconstruction
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock
from cbsr_qa.domain.results.report import Banner, CommandOutcome, Figure, Page, Section
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.scaling import changes, scale_doubts, scale_of
from cbsr_qa.plugin.creation import create_plugin
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.report.document import ChosenParameter
from cbsr_qa.report.draw.images import ImagePanel, image_figure
from cbsr_qa.report.tables import plural
from cbsr_qa.system.copies import end_forked_copies

#: Largest number of images that are drawn.
_MOST_DRAWN: Final = 6
_NO_SCALE: tuple[str, ...] = (
    "the frames are changes of unknown scale: places and signs count, the size of images does not",
)


@dataclass(frozen=True, slots=True, eq=False)
class ImagedFrames:
    """Images of frames.

    Parameters
    ----------
    frames, readings, elements : numbers of imaged frames, of readings of each, and of elements.
    warnings : what makes the images doubtful.
    values : (frames, elements) relative conductance change; not in a document.
    mesh, sensor_type : mesh and sensor type of the images; not in a document.
    """

    reconstruction: str
    parameter: ChosenParameter
    frames: int
    readings: int
    elements: int
    warnings: tuple[str, ...]
    values: Annotated[InstanceOf[Array], Field(exclude=True)]
    mesh: Annotated[InstanceOf[Mesh], Field(exclude=True)]
    sensor_type: Annotated[InstanceOf[SensorType], Field(exclude=True)]


def image_frames(
    frames: FrameBlock,
    reference: FrameBlock | None,
    sensor_type: SensorType,
    chosen: PluginChoice | None = None,
    *,
    tell: Callable[[str], None] = lambda stage: None,
) -> ImagedFrames:
    """Image frames relative to the mean of those of the unloaded sheet.

    Readings that are flagged in a frame of either are left out of all. Changes have no scale of their own: the
    largest of them counts as a tenth of the largest reading, and a warning says so.

    Parameters
    ----------
    reference : frames of the unloaded sheet, at least one, in the unit of the others and at their current; None if
        the frames are changes from it.
    chosen : reconstruction and its options; by default that of ``analyse``.

    Raises
    ------
    PluginError
        If there is no such reconstruction, or its options are wrong.
    NumericsError
        If frames or reference do not fit the sensor type, a frame is in another unit, too few readings are left, or
        the method cannot image them.
    """
    chosen = chosen or PluginChoice(DEFAULT_RECONSTRUCTION, {})
    blocks = [frames] if reference is None else [frames, reference]
    _check_alike(blocks, sensor_type)
    method: Reconstruction = create_plugin(discover(), Kind.RECONSTRUCTION, chosen, "reconstruction")
    flagged = ((np.concatenate([block.flags for block in blocks]) & UNUSABLE) != 0).any(axis=0)
    used_mask = sensor_type.pattern.select_imaged(~flagged)
    tell(f"preparing {chosen.name}")
    problem = imaging_problem(sensor_type, used=used_mask)
    if reference is None:
        unloaded, doubts = np.zeros(used_mask.shape), _NO_SCALE
        scale = 1 / float(difference_model(frames.voltages[:, used_mask], problem).gain[0])
    else:
        unloaded = reference.voltages.mean(axis=0)
        _check_units(frames.voltages[:, used_mask], unloaded[used_mask])
        scale, doubts = scale_of(unloaded, problem), scale_doubts(unloaded, problem)
    if getattr(method, "absolute", False) and reference is not None:
        problem = imaging_problem(sensor_type, used=used_mask, measured=unloaded / scale)
    with end_forked_copies():
        prepared: PreparedReconstruction = method.prepare(problem)
    tell(f"imaging {plural(len(frames), 'frame')}")
    with end_forked_copies():
        values = np.asarray(prepared.images(changes(frames.voltages, unloaded, problem, scale)), dtype=np.float64)
    if values.shape != (len(frames), len(problem.mesh.elements)) or not np.isfinite(values).all():
        raise NumericsError(f"{chosen.name} made images of shape {values.shape}, or of values that are not finite")
    return ImagedFrames(
        prepared.method,
        ChosenParameter.from_choice(prepared.choice),
        len(frames),
        len(problem.reference),
        len(problem.mesh.elements),
        doubts,
        values,
        problem.mesh,
        sensor_type,
    )


def _check_units(frames: Array, unloaded: Array) -> None:
    """Refuse frames (n, m) in another unit than the unloaded one (m,)."""
    size = float(np.linalg.norm(unloaded))
    for number, frame in enumerate(frames):
        if ratio := find_other_unit(float(np.linalg.norm(frame)), size):
            raise NumericsError(
                f"frame {number} (from 0) is {ratio:.3g} times as large as that of the unloaded sheet:"
                " is it in another unit?",
                remedy="give all frames in one unit",
            )


def _check_alike(blocks: Sequence[FrameBlock], sensor_type: SensorType) -> None:
    shape = sensor_type.pattern.shape
    for noun, block in zip(("frames", "frames of the unloaded sheet"), blocks, strict=False):
        if block.voltages.shape[1:] != shape:
            raise NumericsError(
                f"sensor type {sensor_type.name!r} has frames of {shape}, the {noun} have {block.voltages.shape[1:]}",
                remedy="give frames of that shape, or the sensor type that was recorded",
            )
        if not len(block):
            raise NumericsError(f"there are no {noun}")
    frames, reference = blocks[0], blocks[-1]
    if frames.unit is not reference.unit or (frames.current_A or reference.current_A) != (
        reference.current_A or frames.current_A
    ):
        raise NumericsError(
            "the frames of the unloaded sheet differ from the others in their unit or drive current",
            remedy="give frames of one recording",
        )


def image_outcome(imaged: ImagedFrames) -> CommandOutcome[ImagedFrames]:
    """Lay out images: the parameter, and drawings of some images, evenly spread."""
    chosen = sorted({round(n) for n in np.linspace(0, imaged.frames - 1, min(imaged.frames, _MOST_DRAWN))})
    panels = [ImagePanel(f"frame {n}", Image(imaged.mesh, imaged.values[n])) for n in chosen]
    count = f"{plural(imaged.readings, 'reading')} a frame, {imaged.elements} elements"
    parameter = imaged.parameter
    facts = (
        ("Reconstruction", imaged.reconstruction),
        (parameter.name, f"{parameter.value:.3g}: {parameter.reason}"),
    )
    banner = Banner("plain", "●", plural(imaged.frames, "image"), count)
    sensor = imaged.sensor_type
    figure = Figure(
        "Conductance change relative to the unloaded sheet.",
        f"Images of {plural(len(panels), 'frame')}.",
        lambda: image_figure(panels, sheet=sensor.outline, electrodes=sensor.electrodes),
    )
    page = replace(Page("Images", sensor.name, banner, facts), warnings=imaged.warnings)
    return CommandOutcome(imaged, page, (Section("Images", (figure,)),))
