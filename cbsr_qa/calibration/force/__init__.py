"""How a sensor's readings become newtons: learning, templates, validity."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
