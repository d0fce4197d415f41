from .absolute_images import AbsoluteImages as AbsoluteImages, Expected as Expected
from .total_variation import MOST_STEPS as MOST_STEPS, TOLERANCE as TOLERANCE
from .total_variation_images import TotalVariationImages as TotalVariationImages, choose_alpha as choose_alpha
