"""Station, recipe, sensor type, material and scene files: TOML to pydantic to domain."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
