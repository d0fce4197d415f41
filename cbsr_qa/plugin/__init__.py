"""The door for plugins: hooks, Protocols, instruments, and how plugins are found."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
