"""The linearised inverse problem and what reconstructions share: priors, one-step solutions, noise."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
