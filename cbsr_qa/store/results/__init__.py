"""Analyses and calibrations."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import (
        analyses as analyses,
        calibrations as calibrations,
        calibrations_of_before as calibrations_of_before,
        reanalyses as reanalyses,
    )
    from .analyses import (
        StoredAnalysis as StoredAnalysis,
        analysis_outcome as analysis_outcome,
        stored_measurement as stored_measurement,
    )
    from .calibrations import check_files as check_files
    from .reanalyses import AdoptedRuns as AdoptedRuns, Reanalysis as Reanalysis, key_of as key_of

door(__name__, __file__)
