"""The door for plugins: hooks, Protocols, instruments, and how plugins are found."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
