"""The checks before every run, and what they rest on: releases of files."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
