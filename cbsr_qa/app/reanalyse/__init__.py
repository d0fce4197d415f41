"""A changed analysis over many stored runs: values, verdicts that flip, and their adoption."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .reanalysis import ReanalyseRequest as ReanalyseRequest, reanalyse as reanalyse
    from .report import Reanalysed as Reanalysed, reanalysed_outcome as reanalysed_outcome
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
