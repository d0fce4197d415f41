"""How much to smooth: noise figure, criteria, and what each would choose."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
