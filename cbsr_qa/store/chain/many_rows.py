"""Digests of the documents of many rows, column by column: a third of the time of row by row.

Canonical text is the same as that of :func:`~cbsr_qa.store.chain.run_documents.row_text`, which tests compare.
"""

import hashlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from itertools import repeat
from math import isfinite
from operator import add
from types import NoneType
from typing import Any, Final

from sqlalchemy import Table

from cbsr_qa.store.chain.run_documents import KEYS, double_text, list_writers, sha256

#: Words are written once where a column repeats each of them so often.
_MIN_REPETITIONS: Final = 4


def keys_of(table: Table, columns: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return the key of the document that each row belongs to."""
    names = KEYS[table.name]
    if not names:
        return [""] * len(next(iter(columns.values())))
    return list(map("/".join, zip(*(map(str, columns[name]) for name in names), strict=True)))


def documents_in_columns(table: Table, columns: Mapping[str, Sequence[Any]], keys: Sequence[str]) -> dict[str, str]:
    """Return the content digest of every document, by its key.

    Parameters
    ----------
    columns : cells of every row, by the name of their column.
    keys : of the document of each row, from :func:`keys_of`.
    """
    texts = row_texts(table, columns)
    if len(set(keys)) == len(keys):
        return dict(zip(keys, [hashlib.sha256(text.encode()).hexdigest() for text in texts], strict=True))
    grouped = defaultdict[str, list[str]](list)
    for key, text in zip(keys, texts, strict=True):
        grouped[key].append(text)
    return {key: sha256(*sorted(document_texts)) for key, document_texts in grouped.items()}


def row_texts(table: Table, columns: Mapping[str, Sequence[Any]]) -> list[str]:
    """Return rows as canonical JSON: what row_text returns of each of them."""
    cells = [_texts(key, how, columns[name]) for name, key, how in list_writers(table)]
    filled = [texts for texts in cells if texts is not None]
    if not filled:
        return ["{}"] * len(next(iter(columns.values())))
    if any("" in texts for texts in filled):
        return [f"{{{','.join(filter(None, texts))}}}" for texts in zip(*filled, strict=True)]
    return [f"{{{text}}}" for text in map(",".join, zip(*filled, strict=True))]


def _texts(key: str, how: Callable[[Any], str], column: Sequence[Any]) -> Sequence[str] | None:
    """Write the cells of a column, "" where it is empty; None if all are."""
    kinds = set(map(type, column))
    if kinds <= {NoneType}:
        return None
    if len(kinds) == 1 and not kinds & {dict, list}:  # cells of several types may be equal and be written unlike
        if kinds == {float} and how is double_text and all(map(isfinite, column)):
            # As run_documents._double: 0 is added because SQLite keeps no −0.
            return [key + text for text in map(float.__repr__, map(add, column, repeat(0.0)))]
        distinct = set(column)
        if len(distinct) * _MIN_REPETITIONS <= len(column):
            written_once = {cell: key + how(cell) for cell in distinct}
            return list(map(written_once.__getitem__, column))
    objects = {id(cell): cell for cell in column}  # JSON that many rows share is parsed once
    if len(objects) * _MIN_REPETITIONS <= len(column):
        texts = {identity: "" if cell is None else key + how(cell) for identity, cell in objects.items()}
        return [texts[id(cell)] for cell in column]
    return ["" if cell is None else key + how(cell) for cell in column]
