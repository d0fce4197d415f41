"""Images of any frames by any reconstruction."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from cbsr_qa.app.imaging import ImagedFrames, image_frames, image_outcome
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.interface.frames import Frames, frame_block, sensor_type_of
from cbsr_qa.interface.result import Progress, Result, quiet
from cbsr_qa.interface.rows import RowOptions, Rows, rows_recording

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


class Images(Result[ImagedFrames]):
    """Images, in the order of their frames."""

    @property
    def values(self) -> "NDArray[np.float64]":
        """Relative conductance change, (frames, elements)."""
        return self.result.values

    @property
    def mesh(self) -> Mesh:
        """The elements: ``nodes_mm``, ``elements``, ``centroids_mm``, ``areas_mm2``."""
        return self.result.mesh

    def plot(self, axes: "Axes | None" = None, *, frame: int = -1) -> "Axes":
        """Draw one image with its electrodes; returns the axes."""
        from cbsr_qa.interface.plots import make_axes
        from cbsr_qa.report.draw.images import ImagePanel, draw_image

        axes = make_axes() if axes is None else axes
        draw_image(axes, ImagePanel("", Image(self.mesh, self.values[frame])), self.result.sensor_type)
        return axes


def image(
    frames: Rows,
    reference: "Rows | None" = None,
    *,
    sensor_type: str | Path | SensorType | None = None,
    pattern: "Rows | None" = None,
    differences: bool = False,
    complex_part: str | None = None,
    reconstruction: str = "gauss-newton-noser",
    progress: Progress | None = None,
    **options: Any,
) -> Images:
    """Image frames relative to the mean of frames of the unloaded sheet.

    Parameters
    ----------
    frames, reference : arrays (n, drives, measures) or (drives, measures) [V], or datasets of frames. With a pattern:
        tables (paths), or arrays (n, columns) in any unit.
    pattern, complex_part : of a table or of rows; see :func:`cbsr_qa.analyse`.
    differences : whether frames are changes from the unloaded sheet; there is no reference then.
    sensor_type : file, shipped name, or loaded; by default the one that the dataset names.
    reconstruction, options : as ``cbsr-qa plugins list --kind reconstruction`` lists them.
    progress : receives what is being done, in words, e.g. ``print``: some methods need tens of seconds.

    Raises
    ------
    CbsrError
        If sensor type, reconstruction or an option is unknown, or the frames do not fit.
    """
    chosen = PluginChoice(reconstruction, options)
    if differences is (reference is not None):
        raise RefusedError(
            f"{'both differences and' if differences else 'neither differences nor'} a reference",
            remedy="give frames of the unloaded sheet, or differences=True if the frames are changes from it",
        )
    if pattern is None:
        if complex_part is not None:
            raise RefusedError("complex_part without a pattern", remedy="give the pairs of the columns")
        block = frame_block(cast(Frames, frames))
        unloaded = None if reference is None else frame_block(cast(Frames, reference))
        named_type = sensor_type_of(cast(Frames, frames), sensor_type)
    else:
        row_options = RowOptions(pattern, differences, reference, complex_part)
        scanned_type = sensor_type_of(cast(Frames, frames), sensor_type, scanned=True)
        recording, named_type = rows_recording(frames, row_options, scanned_type)
        block, unloaded = recording.frames, recording.reference
    return Images(image_outcome(image_frames(block, unloaded, named_type, chosen, tell=progress or quiet)))
