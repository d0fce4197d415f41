"""What is learned of one sheet: response map, baseline, characteristic, data sheet."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
