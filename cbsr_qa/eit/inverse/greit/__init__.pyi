from .matrix import greit_matrix as greit_matrix, hyperparameter_for as hyperparameter_for
from .targets import TargetDesign as TargetDesign
