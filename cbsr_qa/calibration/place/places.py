"""Places of touches in frames, with their regions and flags."""

from dataclasses import dataclass

from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.domain.numbers import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Places of touches in n frames, in the frame of the presses.

    Parameters
    ----------
    place_mm : (n, 2) places; NaN if more than half of the readings are lost, or by the modelled sheet any.
    covariance_mm2 : (n, 2, 2) Σ; the region of 68 % is all d with dᵀΣ⁻¹d at most ``q68`` of the estimator.
    misfit : (n,) squared misfit per reading over its limit for learned touches.
    strength : (n,) strength of the changes, relative to the learned ones at the place; one by the modelled sheet.
    flags : (n,) values of :class:`~cbsr_qa.calibration.force.inverse.Flag`.
    unsure : (n,) standard deviation of the logarithm of the strength for want of lost readings; zero in whole frames.
    """

    place_mm: Array
    covariance_mm2: Array
    misfit: Array
    strength: Array
    flags: Indices
    unsure: Array | float = 0.0

    @property
    def in_model(self) -> Mask:
        """Whether each frame (n,) is one touch similar to the learned ones, or of the modelled sheet."""
        other_flags = int(Flag.NOT_DETECTED | Flag.MORE_THAN_ONE | Flag.UNREADABLE | Flag.NOT_AS_MODELLED)
        model_mask: Mask = (self.flags & other_flags) == 0
        return model_mask
