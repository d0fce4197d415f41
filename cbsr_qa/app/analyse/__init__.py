"""Recorded data through the same analysis as a run."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .analyse import (
        AnalyseRequest as AnalyseRequest,
        analyse_file as analyse_file,
        analyse_frames as analyse_frames,
    )
    from .outcome import (
        Analysed as Analysed,
        AnalysedFiles as AnalysedFiles,
        ChosenParameter as ChosenParameter,
        analyse_outcome as analyse_outcome,
    )

door(__name__, __file__)
