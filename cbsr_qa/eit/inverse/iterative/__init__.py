"""Iterative reconstructions: total variation, and absolute Gauss–Newton."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .absolute_images import AbsoluteImages as AbsoluteImages, Expected as Expected
    from .total_variation import MOST_STEPS as MOST_STEPS, TOLERANCE as TOLERANCE
    from .total_variation_images import TotalVariationImages as TotalVariationImages, choose_alpha as choose_alpha

door(__name__, __file__)
