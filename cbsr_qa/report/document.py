"""An outcome as a JSON document, and the JSON Schema of it: both from the fields of its dataclass."""

import json
from datetime import date
from functools import lru_cache
from typing import Any

from pydantic import TypeAdapter


def json_document(result: Any) -> dict[str, Any]:
    """Return a result as JSON has it: fields by name, tuples as lists, dates and times as text (ISO 8601)."""
    kind: type = type(result)
    # pydantic would write UTC as Z, which Python 3.10 and the other documents do not know
    document: dict[str, Any] = json.loads(
        json.dumps(_adapter(kind).dump_python(result, by_alias=True), default=_text)
    )
    return document


def _text(moment: date) -> str:
    return moment.isoformat()


def json_schema(kind: type) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of the documents of a kind of result."""
    return _adapter(kind).json_schema(mode="serialization")


@lru_cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
