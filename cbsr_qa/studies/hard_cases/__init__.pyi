from .report import stability_outcome as stability_outcome
from .stability import Stability as Stability, examine_cases as examine_cases
