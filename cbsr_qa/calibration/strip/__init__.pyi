from .characterisation import Specimen as Specimen, characterise as characterise
from .relaxation import KernelCurve as KernelCurve, mean_trace as mean_trace
from .slow_residue import (
    SlowResidue as SlowResidue,
    changes_of as changes_of,
    separate_with_residue as separate_with_residue,
    without_residue as without_residue,
)
