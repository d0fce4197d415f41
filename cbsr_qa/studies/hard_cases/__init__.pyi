from .case import CaseResult as CaseResult, Ending as Ending
from .stability import Stability as Stability, examine_cases as examine_cases
