"""GREIT: training targets, imaging matrix, amplitude calibration."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .matrix import greit_matrix as greit_matrix, hyperparameter_for as hyperparameter_for
    from .targets import TargetDesign as TargetDesign

door(__name__, __file__)
