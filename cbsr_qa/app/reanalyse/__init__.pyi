from .reanalysis import ReanalyseRequest as ReanalyseRequest, reanalyse as reanalyse
from .report import Reanalysed as Reanalysed, reanalysed_outcome as reanalysed_outcome
