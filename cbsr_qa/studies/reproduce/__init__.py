"""Reproduction of a publication's tables with simulated sensors."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .compare import deviations_agree as deviations_agree
    from .report import reproduction_outcome as reproduction_outcome
    from .reproduce import Reproduction as Reproduction, published as published, reproduce_paper as reproduce_paper

door(__name__, __file__)
