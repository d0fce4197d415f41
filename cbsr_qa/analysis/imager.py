"""From stored voltages to relative conductance images, against a reference frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.frames import FrameBlock
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.reconstruction import LinearReconstruction
from cbsr_qa.reconstruct.scaling import changes


@dataclass(frozen=True, slots=True, eq=False)
class Imager:
    """A reconstruction with the reference it images against.

    Parameters
    ----------
    reconstruction : the prepared matrix.
    reference : (drives, measures) float64 V, the unloaded frame.
    scale : sensor against unit model, see :class:`~cbsr_qa.domain.reconstruction.LinearReconstruction`.
    """

    reconstruction: LinearReconstruction
    reference: NDArray[np.float64]
    scale: float

    @property
    def mesh(self) -> Mesh:
        """Mesh of the images."""
        return self.reconstruction.problem.mesh

    def images(self, frames: FrameBlock, *, reference: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Image frames as one matrix product.

        Parameters
        ----------
        frames : n frames.
        reference : (drives, measures) to image against instead of the own one.

        Returns
        -------
        (n, elements) float64, relative conductance change.
        """
        against = self.reference if reference is None else reference
        return self.reconstruction.images(changes(frames.voltages, against, self.reconstruction.problem, self.scale))
