"""What the command line prints: one JSON document on stdout, or words; messages always go to stderr."""

import json
import sys
from collections.abc import Mapping
from typing import Any

import typer

#: Common option: ``--json`` prints one document on stdout and nothing else.
JsonOption = typer.Option(False, "--json", help="Print one JSON document on stdout and nothing else.")


def emit_json(document: Mapping[str, Any]) -> None:
    """Print one document on stdout.

    Raises
    ------
    ValueError
        If a number in it is NaN or infinite: such a document is not JSON.
    """
    sys.stdout.write(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def say(text: str = "") -> None:
    """Print words for people on stdout (only where ``--json`` was not asked for)."""
    sys.stdout.write(text + "\n")


def note(text: str) -> None:
    """Print a message on stderr."""
    sys.stderr.write(text + "\n")
