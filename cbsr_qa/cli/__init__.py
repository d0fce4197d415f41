"""The command line."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .command import commands as commands, documents as documents
    from .main import app as app, ended as ended, guarded as guarded
    from .options import plugin_options as plugin_options
    from .output import ask_operator as ask_operator, operator_at_terminal as operator_at_terminal

door(__name__, __file__)
