"""From press cycles on a strip to its material's parameters."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .characterisation import Specimen as Specimen, characterise as characterise
    from .relaxation import KernelCurve as KernelCurve, mean_trace as mean_trace
    from .slow_residue import (
        SlowResidue as SlowResidue,
        changes_of as changes_of,
        separate_with_residue as separate_with_residue,
        subtract_residue as subtract_residue,
    )

door(__name__, __file__)
