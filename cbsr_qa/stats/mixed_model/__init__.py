"""Mixed model: groups and stations fixed, sensors random."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .model import Fit as Fit, fit as fit

door(__name__, __file__)
