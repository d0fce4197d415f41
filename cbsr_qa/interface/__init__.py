"""``import cbsr_qa as qa``: what notebooks and scripts may rely on, re-exported by :mod:`cbsr_qa`."""

from cbsr_qa.lazy import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
