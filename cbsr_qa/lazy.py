"""Doors of packages: names that are loaded when they are first used."""

import ast
import sys
from importlib import import_module
from pathlib import Path
from typing import Any


def door(package: str, file: str) -> None:
    """Make importable what a package's file imports for type checkers alone, each name loaded when it is first used.

    As ``lazy_loader.attach_stub``, which a robot does not have: there numpy, scipy and h5py are all there is. The
    package gets its ``__getattr__``, ``__dir__`` and ``__all__``.

    Parameters
    ----------
    package, file : ``__name__`` and ``__file__`` of the package.
    """
    modules = {
        alias.name: node.module for node in listed(Path(file).read_text(encoding="utf-8")) for alias in node.names
    }
    names, own = sorted(modules), vars(sys.modules[package])

    def load(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = import_module(f"{package}.{modules[name] or name}")
        own[name] = getattr(module, name) if modules[name] else module  # found without this function from now on
        return own[name]

    own.update(__getattr__=load, __dir__=lambda: names, __all__=names)


def listed(source: str) -> list[ast.ImportFrom]:
    """Return the imports under ``if TYPE_CHECKING`` of a door: what it offers."""
    blocks = [node for node in ast.parse(source).body if isinstance(node, ast.If)]
    return [node for block in blocks for node in block.body if isinstance(node, ast.ImportFrom)]
