"""Digests of a calibration's content: over values, units and shapes, not over a file's bytes.

``digest`` covers everything. It can be recomputed from the file with h5py and hashlib alone: feed a SHA-256 with the
line ``cbsr-qa calibration TAB schema_version NEWLINE`` and then, for every dataset in the order of its path (without
leading ``/``, sorted by Unicode code point), with the UTF-8 bytes of the line
``path TAB units TAB kind TAB shape NEWLINE``, where ``kind`` is ``f8``, ``f4``, ``i8``, ``u1`` or ``text`` and
``shape`` the lengths joined by ``x`` (empty for one value), and with the data in C order: little-endian numbers, or
for each text its length in bytes in decimal, a NEWLINE and its UTF-8 bytes.

``record_digest`` is the same sum over the datasets that no program can work out again: all but those named by
:data:`PREPARED`. Mesh, model, matrix and the templates of the head follow from sensor type, method, parameter, head,
used readings and their merging, which are covered, and the readings' noise from the run's unloaded frames, but only
to rounding, which is another one on another computer. So a calibration that is put together again from a database
has its ``record_digest`` to the bit anywhere, and its ``digest`` where the arithmetic is the same.

A digest tells damage and careless editing; it is not a signature.
"""

import hashlib
from collections.abc import Mapping
from typing import Final

import numpy as np

from cbsr_qa.calibration.file.content import Entry, Value
from cbsr_qa.domain import tabulated
from cbsr_qa.domain.results import Calibration

FORMAT: Final = "cbsr-qa calibration"
#: Version of what holds matrix and Jacobian in single precision; in double precision they are written as before.
_SINGLE_MATRIX: Final = 3

_TABLE: Final = tuple(tabulated(Calibration))
#: Paths, or beginnings of paths, of what is prepared again from the rest.
PREPARED: Final = tuple(path for path, field in _TABLE if field.kept.prepared)
#: The same of what later versions added, with the version.
_SINCE: Final = tuple((path, field.kept.since) for path, field in _TABLE if field.kept.since > 1)
SCHEMA_VERSION: Final = max([_SINGLE_MATRIX, *(since for _, since in _SINCE)])


def schema_version(entries: Mapping[str, Entry]) -> int:
    """Return the lowest schema version that has all of some entries: what was issued before keeps its digests."""
    for path in ("reconstruction/matrix", "reconstruction/jacobian"):
        value = entries[path].value if path in entries else None
        if isinstance(value, np.ndarray) and value.dtype == np.float32:
            return max(_SINGLE_MATRIX, _record_version(entries))
    return _record_version(entries)


def _record_version(entries: Mapping[str, Entry]) -> int:
    """Return the version of what is not prepared again: how that is kept says nothing of the record."""
    return max([1, *(since for part, since in _SINCE if any(path.startswith(part) for path in entries))])


def content_digest(entries: Mapping[str, Entry], version: int | None = None) -> str:
    """Return the SHA-256 of entries as described in the module's text, in hexadecimal digits.

    Parameters
    ----------
    version : schema version; by default that of the entries.
    """
    digest = hashlib.sha256(f"{FORMAT}\t{version or schema_version(entries)}\n".encode())
    for path in sorted(entries):
        kind, shape, data = _canonical(entries[path].value)
        digest.update(f"{path}\t{entries[path].units}\t{kind}\t{'x'.join(map(str, shape))}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def record_digest(entries: Mapping[str, Entry]) -> str:
    """Return the same over what is not prepared again from the rest."""
    kept = {path: entry for path, entry in entries.items() if not path.startswith(PREPARED)}
    return content_digest(kept, _record_version(entries))


def _canonical(value: Value) -> tuple[str, tuple[int, ...], bytes]:
    if isinstance(value, np.ndarray):
        kind = {"f8": "<f8", "f4": "<f4", "i8": "<i8", "b1": "|u1"}[value.dtype.str[1:]]
        return kind[1:], value.shape, value.astype(kind).tobytes()
    texts = [text.encode() for text in ((value,) if isinstance(value, str) else value)]
    shape = () if isinstance(value, str) else (len(texts),)
    return "text", shape, b"".join(b"%d\n%s" % (len(text), text) for text in texts)
