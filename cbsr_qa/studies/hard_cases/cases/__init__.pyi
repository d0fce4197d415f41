from .forward_loads import loaded as loaded
