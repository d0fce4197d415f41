"""The database: tables, journal, results, and the chain of digests they are under."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
