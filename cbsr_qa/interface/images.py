"""Images of any frames by any reconstruction."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cbsr_qa.app.imaging import ImagedFrames, image_frames, image_outcome
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.interface.frames import Frames, frame_block, sensor_type_of
from cbsr_qa.interface.result import Progress, Result, quiet

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
        from cbsr_qa.interface.plots import own_axes
        from cbsr_qa.report.draw.images import ImagePanel, draw_image

        axes = own_axes() if axes is None else axes
        draw_image(axes, ImagePanel("", Image(self.mesh, self.values[frame])), self.result.sensor_type)
        return axes


def image(
    frames: Frames,
    reference: Frames,
    *,
    sensor_type: str | Path | SensorType | None = None,
    reconstruction: str = "gauss-newton-noser",
    progress: Progress | None = None,
    **options: Any,
) -> Images:
    """Image frames relative to the mean of frames of the unloaded sheet.

    Parameters
    ----------
    frames, reference : arrays (n, drives, measures) or (drives, measures) [V], or datasets of frames.
    sensor_type : file, shipped name, or loaded; by default the one that the dataset names.
    reconstruction, options : as ``cbsr-qa plugins list --kind reconstruction`` lists them.
    progress : receives what is being done, in words, e.g. ``print``: some methods need tens of seconds.

    Raises
    ------
    CbsrError
        If sensor type, reconstruction or an option is unknown, or the frames do not fit.
    """
    chosen = PluginChoice(reconstruction, options)
    blocks = frame_block(frames), frame_block(reference)
    imaged = image_frames(*blocks, sensor_type_of(frames, sensor_type), chosen, tell=progress or quiet)
    return Images(image_outcome(imaged))
