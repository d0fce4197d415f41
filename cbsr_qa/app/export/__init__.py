"""Stored runs as files that other programs read: tables, frames, outcomes."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
