"""Store and forward: what a station stored is sent to a central database."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
