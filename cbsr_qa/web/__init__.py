"""The page of a line: operators see and start runs in a browser; see docs/decisions/0041."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .server import ServeRequest as ServeRequest, serve as serve

door(__name__, __file__)
