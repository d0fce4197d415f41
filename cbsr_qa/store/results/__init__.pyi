from . import analyses as analyses, calibrations as calibrations
from .analyses import StoredAnalysis as StoredAnalysis, analysis_outcome as analysis_outcome
from .calibration_rows import PrepareForce as PrepareForce
from .calibrations import CalibrationSummary as CalibrationSummary
