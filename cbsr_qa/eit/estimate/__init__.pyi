from .load_estimate import (
    LEAST_DETECTABILITY as LEAST_DETECTABILITY,
    LoadEstimator as LoadEstimator,
    LoadFits as LoadFits,
    contrast_of as contrast_of,
    radius_of as radius_of,
)
from .readings import MergedReadings as MergedReadings, load_model as load_model, merged_readings as merged_readings
