from . import analyses as analyses, calibrations as calibrations, calibrations_of_before as calibrations_of_before
from .analyses import (
    StoredAnalysis as StoredAnalysis,
    analysis_outcome as analysis_outcome,
    as_measurement as as_measurement,
)
