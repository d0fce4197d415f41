"""Packages of plugins: made from templates, and checked whether installed or not."""

from cbsr_qa import door

__getattr__, __dir__, __all__ = door(__name__, __file__)
