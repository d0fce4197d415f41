"""Images of a run that is still going on, and what a load looks like in them: a preview, which judges nothing.

The reference is the mean of the unloaded frames so far. A reading is used unless it is flagged in one of them.
Defects that show only over a whole run (offsets, spikes, loose electrodes) are left to the analysis of the run.
"""

from dataclasses import dataclass
from typing import Self

from cbsr_qa.analysis.run.imaging import Imager, find_sensed_regions, mean_under
from cbsr_qa.analysis.run.reference import split_unloaded
from cbsr_qa.domain.imaging import linear
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.readings.frames import UNUSABLE, FrameBlock
from cbsr_qa.domain.readings.loads import Indenter, Load
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.imaging.blobs import noise_floor
from cbsr_qa.eit.imaging.shape import spatial_figures
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.scaling import scale_of
from cbsr_qa.plugin.interfaces import Reconstruction


@dataclass(frozen=True, slots=True)
class PlacePreview:
    """How well a load is seen.

    Parameters
    ----------
    error_mm, overlap_percent : error of the place [mm] and overlap [%] of the imaged region nearest to the indenter,
        at the recipe's main mask; None where no region is seen.
    """

    error_mm: float | None
    overlap_percent: float | None


@dataclass(frozen=True, slots=True, eq=False)
class LivePreview:
    """Images of a run relative to its unloaded frames so far."""

    imager: Imager
    noise_floor: float
    settings: AnalysisSettings
    indenter: Indenter

    @classmethod
    def prepare(
        cls,
        sensor_type: SensorType,
        indenter: Indenter,
        settings: AnalysisSettings,
        reconstruction: Reconstruction,
        unloaded: FrameBlock,
    ) -> Self:
        """Prepare the images.

        Parameters
        ----------
        unloaded : frames of the rested sheet before the first press.

        Raises
        ------
        NumericsError
            If these are too few, too few readings are usable, or the method is not linear.
        """
        for_noise, for_reference = split_unloaded(unloaded, settings.noise_floor_frames)
        used_mask = sensor_type.pattern.usable() & ~((unloaded.flags & UNUSABLE) != 0).any(axis=0)
        prepared = linear(reconstruction.prepare(imaging_problem(sensor_type, used=used_mask)))
        reference = for_reference.voltages.mean(axis=0)
        imager = Imager(prepared, reference, scale_of(reference, prepared.problem))
        return cls(imager, noise_floor(imager.images(for_noise)), settings, indenter)

    @property
    def mesh(self) -> Mesh:
        return self.imager.mesh

    def image(self, frames: FrameBlock) -> Array:
        """Return the mean image of some frames: (e,) float64, relative conductance change of each element."""
        mean_image: Array = self.imager.images(frames).mean(axis=0)
        return mean_image

    def place(self, load: Load, steady: FrameBlock) -> PlacePreview:
        """Return how well a load is seen.

        Parameters
        ----------
        steady : the last frames of its hold.
        """
        image, footprint = self.image(steady), self.indenter.footprint_at(load.x_mm, load.y_mm)
        # Regions are sought where the image is positive, and a load may also lower the conductance.
        positive_image = image if mean_under(self.mesh, image, footprint) >= 0 else -image
        regions = find_sensed_regions(self.mesh, positive_image, self.noise_floor, self.settings, footprint)
        settings = self.settings
        figures = spatial_figures(regions, footprint, clipping=settings.clipping, perimeter=settings.perimeter)
        index = settings.masks.index(settings.main_mask)
        if (figure := figures[index]) is None:
            return PlacePreview(None, None)
        return PlacePreview(figure.error_mm, figure.overlap_percent)
