from .compare import deviations_agree as deviations_agree
from .report import reproduction_outcome as reproduction_outcome
from .reproduce import Reproduction as Reproduction, published as published, reproduce_paper as reproduce_paper
