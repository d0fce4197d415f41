"""Maximum-likelihood estimate of place and strength of a load, with the Cramér–Rao bound."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .load_estimate import (
        LEAST_DETECTABILITY as LEAST_DETECTABILITY,
        LoadEstimator as LoadEstimator,
        LoadFits as LoadFits,
        contrast_of as contrast_of,
        radius_of as radius_of,
    )
    from .readings import (
        MergedReadings as MergedReadings,
        load_model as load_model,
        merge_reciprocal as merge_reciprocal,
    )

door(__name__, __file__)
