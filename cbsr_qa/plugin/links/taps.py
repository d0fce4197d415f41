"""What listens to the links of a process, or answers in place of the instruments, while a command works."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, Protocol

from cbsr_qa.domain.plan.plan import Station

#: Options of instruments whose values are not written.
_SECRET: Final = ("password", "passphrase", "secret", "token")
_HIDDEN: Final = b"***"


class Tap(Protocol):
    """What stands between drivers and the system's ports and VISA resources."""

    #: Whether it answers in place of instruments, so that nothing real is opened.
    replays: bool

    def connect(self, role: str, open_real: Callable[[], Any]) -> Any:
        """Return a port or resource for a role; ``open_real`` opens the real one."""
        ...

    def describe_last(self, role: str) -> str:
        """Say what was sent last to an instrument, and what came then; empty if nothing was sent."""
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


def list_secrets(station: Station) -> list[bytes]:
    """Values of the instruments' options that are named like secrets, the longest first."""
    options: list[Mapping[str, Any]] = [spec.options for spec in station.instruments]
    found = {
        str(value).encode()
        for table in options
        for key, value in table.items()
        if value and any(word in key.lower() for word in _SECRET)
    }
    return sorted(found, key=lambda secret: (-len(secret), secret))
