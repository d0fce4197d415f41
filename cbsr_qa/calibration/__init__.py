"""What a sensor's own loads teach: fits, the sheet's response, force, and the file that is issued."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
