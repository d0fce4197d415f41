"""Station, recipe, sensor type, material and scene files: TOML to pydantic to domain."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
