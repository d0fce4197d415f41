"""What listens to the links of a process, or answers in place of the instruments, while a command works."""

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, Protocol

from cbsr_qa.domain.plan.plan import Station

#: Options of instruments with one of these in their name are not written, nor what is in a table of such a name.
_SECRET: Final = ("password", "passwd", "passphrase", "pwd", "secret", "token", "credential")
#: ... nor these, nor those that end in ``key``: a ``reset_pin`` is a wire.
_SECRET_NAMES: Final = ("pin", "pass")
#: Shorter ones, or of fewer different characters, occur in other words and numbers.
_SHORTEST, _FEWEST = 6, 3
_HIDDEN: Final = b"***"


class Tap(Protocol):
    """What stands between drivers and the system's ports and VISA resources."""

    #: Whether it answers in place of instruments, so that nothing real is opened.
    replays: bool

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        """Return a port or resource for a role; ``open_real`` opens the real one."""
        ...

    def describe_last(self, role: str) -> str:
        """Say what was sent last to an instrument, and what came then; empty if neither."""
        ...


_taps: list[Tap] = []


def current_tap() -> Tap | None:
    """Return the tap of this process, if any."""
    return _taps[-1] if _taps else None


def is_replaying() -> bool:
    """Whether instruments are replayed, so that none is opened or emulated."""
    tap = current_tap()
    return tap is not None and tap.replays


@contextmanager
def use_tap(tap: Tap | None) -> Iterator[None]:
    """Have all links that are opened meanwhile go through a tap; None changes nothing."""
    if tap is None:
        yield
        return
    _taps.append(tap)
    try:
        yield
    finally:
        _taps.remove(tap)


def is_timeout(error: Exception) -> bool:
    """Whether a VISA resource did not answer in time."""
    return bool(getattr(error, "error_code", None) == make_timeout().error_code)


def make_timeout() -> Any:
    """Return the error of a VISA resource that did not answer in time."""
    from pyvisa.constants import StatusCode  # a station without such a resource does not load it
    from pyvisa.errors import VisaIOError

    return VisaIOError(StatusCode.error_timeout)


def hide(data: bytes, secrets: Sequence[bytes]) -> bytes:
    """Return bytes with every secret replaced by stars."""
    for secret in secrets:
        data = data.replace(secret, _HIDDEN)
    return data


def count_begun(data: bytes, secrets: Sequence[bytes]) -> int:
    """Count the bytes at the end of what was said that may be the beginning of a secret."""
    begun = (size for secret in secrets for size in range(1, len(secret)) if data.endswith(secret[:size]))
    return max(begun, default=0)


def list_secrets(station: Station, role: str | None = None) -> list[bytes]:
    """Values of options that are named like secrets, also in base64, the longest first; of one instrument or all."""
    specs = [spec for spec in station.instruments if role in (None, spec.role)]
    texts = {text.encode() for spec in specs for _, text in _find_secrets(spec.role, spec.options, is_secret=False)}
    found = texts | {code for text in texts if len(text) >= _SHORTEST for code in _encode(text)}
    return sorted(found, key=lambda secret: (-len(secret), secret))


def find_unhidable(station: Station) -> str:
    """Return the first option whose value cannot be hidden without damage to other words; empty if none."""
    tables = {spec.role: spec.options for spec in station.instruments}
    for name, text in _find_secrets("instruments", tables, is_secret=False):
        if len(text) < _SHORTEST or len(set(text)) < _FEWEST:
            return name
    return ""


def _find_secrets(name: str, value: Any, *, is_secret: bool) -> Iterator[tuple[str, str]]:
    """Yield name and text of each secret in an option, which may be a table or a list."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            small = key.lower()
            is_named = small in _SECRET_NAMES or small.endswith(("key", "keys")) or any(map(small.count, _SECRET))
            yield from _find_secrets(f"{name}.{key}", inner, is_secret=is_secret or is_named)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _find_secrets(name, inner, is_secret=is_secret)
    elif is_secret and value and not isinstance(value, bool):
        yield name, str(value)


def _encode(secret: bytes) -> Iterator[bytes]:
    """Yield what base64 makes of a secret, whatever stands before it: of "user:password", say."""
    for before in range(3):
        first, last = -(-8 * before // 6), 8 * (before + len(secret)) // 6  # characters of the secret's bits alone
        data = bytes(before) + secret
        yield from {code(data)[first:last] for code in (base64.b64encode, base64.urlsafe_b64encode)} - {b""}
