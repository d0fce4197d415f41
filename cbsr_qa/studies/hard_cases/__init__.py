"""Numerically hard cases, each compared with a known truth."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .report import stability_outcome as stability_outcome
    from .stability import Stability as Stability, examine_cases as examine_cases

door(__name__, __file__)
