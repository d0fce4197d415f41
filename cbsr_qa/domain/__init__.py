"""Words of the trade, which every layer and every plugin may use: errors, numbers, and rooms for the rest."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
