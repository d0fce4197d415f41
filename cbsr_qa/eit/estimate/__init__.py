"""Where a load is and how strong, by maximum likelihood, with its bound."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
