"""Content of an HDF5 file, checked before any of it is read, with the same rules for calibrations and recordings."""

from collections.abc import Iterator
from typing import Any, Final

import h5py

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.system.untrusted import largest_content

#: Largest number of groups and datasets: more than in any of our files.
MOST_NAMES: Final = 10_000
#: Largest number of groups that enclose a dataset.
DEEPEST: Final = 4
_MOST_ATTRIBUTES: Final = 100
_LARGEST_ATTRIBUTE: Final = 2**16
#: Largest number of texts in all datasets together.
_MOST_TEXTS: Final = 100_000
#: Largest number of characters of all texts in one dataset.
_MOST_CHARACTERS: Final = 2**24
_TEXTS_AT_ONCE: Final = 32
#: gzip, byte shuffle and checksum; HDF5 would load a library for any other filter.
_FILTERS: Final = frozenset({1, 2, 3})


def members(
    file: h5py.File, size_bytes: int, most_names: int = MOST_NAMES
) -> Iterator[tuple[str, h5py.Group | h5py.Dataset]]:
    """Iterate over the groups and datasets of a file, each checked before and none read.

    Parameters
    ----------
    size_bytes : size of the file; it limits all datasets by the usual compression.
    most_names : largest number of groups and datasets; opening each takes a fraction of a millisecond.

    Raises
    ------
    RefusedError
        If the file has links, external data, too many names, or datasets that are too large or of a type that is
        neither number nor text.
    """
    yield from _Walk(largest_content(size_bytes), most_names).walk_group(file, "")


class _Walk:
    """Remaining limits of a file."""

    def __init__(self, left: int, most_names: int) -> None:
        self._left = self._all = left
        self._most_names = most_names
        self._names = self._texts = 0

    def walk_group(self, group: h5py.Group, prefix: str) -> Iterator[tuple[str, h5py.Group | h5py.Dataset]]:
        for name in group:
            path = f"{prefix}{name}"
            self._names += 1
            if self._names > self._most_names:
                raise RefusedError(
                    f"more than {self._most_names} names up to {path}: no such file of this program has so many"
                )
            if not path.isprintable():
                raise RefusedError(f"{path!r} is not a name of such a file")
            # Links could lead out of the file, or around in circles.
            if not isinstance(group.get(name, getlink=True), h5py.HardLink) or path.count("/") > DEEPEST:
                raise RefusedError(f"{path} is a link, not content")
            item = group[name]
            if isinstance(item, h5py.Group):
                yield path, item
                yield from self.walk_group(item, f"{path}/")
            else:
                self._check(path, item)
                yield path, item

    def _check(self, path: str, dataset: Any) -> None:
        if not isinstance(dataset, h5py.Dataset) or dataset.external or dataset.is_virtual:
            raise RefusedError(f"{path} does not hold its own data")
        text = h5py.check_string_dtype(dataset.dtype) is not None
        if text and dataset.ndim > 1:
            raise RefusedError(f"{path} holds texts of the shape {dataset.shape}; a list of them is expected")
        self._texts += (dataset.size or 0) if text else 0
        if self._texts > _MOST_TEXTS:
            raise RefusedError(
                f"more than {_MOST_TEXTS} texts up to {path}: no such file of this program has so many"
            )
        unpacked_bytes = _count_unpacked_bytes(dataset)
        if dataset.size is None or unpacked_bytes > self._left:
            raise RefusedError(
                f"{path} of the shape {dataset.shape} is empty or too large: all datasets of a file of this size"
                f" may hold {self._all / 2**20:.0f} MiB together"
            )
        self._left -= unpacked_bytes
        if not text and dataset.dtype.kind not in "iufcb":
            raise RefusedError(f"{path} is of the type {dataset.dtype}, which is neither number nor text")
        packing = dataset.id.get_create_plist()
        if any(packing.get_filter(k)[0] not in _FILTERS for k in range(packing.get_nfilters())):
            raise RefusedError(f"{path} is packed otherwise than with gzip")


def _count_unpacked_bytes(dataset: h5py.Dataset) -> int:
    """Size of all values, or of one chunk if that is larger [bytes]; all types become float64."""
    count = 1
    for length in dataset.chunks or (0,):
        count *= int(length)
    return max(int(dataset.size or 0), count) * max(int(dataset.dtype.itemsize), 8)


def attribute(item: h5py.Group | h5py.Dataset, name: str) -> Any:
    """Return an attribute that is a single number or UTF-8 text; None otherwise."""
    if name not in item.attrs:
        return None
    identifier = item.attrs.get_id(name)
    text = h5py.check_string_dtype(identifier.dtype) is not None
    if (
        identifier.shape != ()
        or identifier.dtype.itemsize > _LARGEST_ATTRIBUTE
        or not (text or identifier.dtype.kind in "iufb")
    ):
        return None
    value = item.attrs[name]
    if isinstance(value, str) and any("\ud800" <= character <= "\udfff" for character in value):
        return None  # bytes that are not UTF-8
    return value


def attribute_names(item: h5py.Group | h5py.Dataset) -> list[str]:
    """Return the names of all attributes, sorted.

    RefusedError if there are more than in any of our files.
    """
    if len(item.attrs) > _MOST_ATTRIBUTES:
        raise RefusedError(f"{item.name} has {len(item.attrs)} attributes; at most {_MOST_ATTRIBUTES} are expected")
    return sorted(item.attrs)


def texts(path: str, dataset: h5py.Dataset) -> str | tuple[str, ...]:
    """Read one text, or a list of them, some at a time: a thousand entries may all point to the same megabyte.

    RefusedError if they have more characters than in any of our files.
    """
    stored_texts = dataset.asstr()
    if not dataset.ndim:
        return str(stored_texts[()])
    texts_read: list[str] = []
    characters_left = _MOST_CHARACTERS
    for first in range(0, dataset.size, _TEXTS_AT_ONCE):
        batch = [str(text) for text in stored_texts[first : first + _TEXTS_AT_ONCE]]
        characters_left -= sum(map(len, batch))
        if characters_left < 0:
            raise RefusedError(
                f"{path} holds more than {_MOST_CHARACTERS} characters: no such file of this program has so many"
            )
        texts_read += batch
    return tuple(texts_read)
