"""The database: tables, journal, results, and the chain of digests they are under."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
