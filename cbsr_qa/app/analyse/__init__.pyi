from .analyse import AnalyseRequest as AnalyseRequest, analyse_file as analyse_file, analyse_frames as analyse_frames
from .outcome import (
    Analysed as Analysed,
    AnalysedFiles as AnalysedFiles,
    ChosenParameter as ChosenParameter,
    analyse_outcome as analyse_outcome,
)
