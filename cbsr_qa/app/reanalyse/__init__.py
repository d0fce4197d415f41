"""A changed analysis over many stored runs: values, verdicts that flip, and their adoption."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .reanalysis import reanalyse as reanalyse
    from .report import Reanalysed as Reanalysed, reanalysed_outcome as reanalysed_outcome
    from .request import ReanalyseRequest as ReanalyseRequest

door(__name__, __file__)
