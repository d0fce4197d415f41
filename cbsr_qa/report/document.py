"""An outcome as a JSON document, and its JSON Schema: both from the fields of its dataclass."""

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import Field, TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

T = TypeVar("T")

#: Annotation of a key that a document omits instead of writing null.
IF_GIVEN: Final = Field(exclude_if=lambda value: value is None)


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why something was refused, and what to do about it."""

    reason: str
    remedy: str


def json_document(result: Any) -> dict[str, Any]:
    """Return a result as JSON: fields by name, tuples as lists, dates and times as text (ISO 8601)."""
    kind: type = type(result)
    # pydantic would write UTC as Z, which Python 3.10 and the other documents do not know
    plain = _adapter(kind).dump_python(result, by_alias=True)
    document: dict[str, Any] = json.loads(
        json.dumps(plain, default=lambda value: str(value) if isinstance(value, Path) else value.isoformat())
    )
    return document


def json_schema(kind: type) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of the documents of a kind of result."""
    return _adapter(kind).json_schema(mode="serialization", schema_generator=_Schema)


class _Schema(GenerateJsonSchema):
    """A key that has one value only, such as an event's ``type``, is always written."""

    def field_is_required(self, field: Any, total: bool) -> bool:
        constant = field["schema"].get("schema", field["schema"])["type"] == "literal"
        return constant or super().field_is_required(field, total)


@lru_cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
