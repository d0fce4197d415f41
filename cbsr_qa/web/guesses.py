"""Wrong tokens and PINs: after several, a client has to wait before the next one is compared."""

import hashlib
import hmac
import math
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from ipaddress import IPv6Address, ip_address, ip_network
from typing import Final

#: Number of different wrong guesses that are compared without a wait.
FREE_GUESSES: Final = 5
#: Longest wait; the first is one second, and each is twice the one before [s].
LONGEST_WAIT_S: Final = 30.0
#: Time without a guess after which all guesses are forgotten [s].
_FORGET_S: Final = 900.0
#: Most guessers, and most guesses of each, that are remembered.
_MAX_GUESSERS: Final = 4096
_MAX_GUESSES: Final = 64


class TooManyGuessesError(Exception):
    """A guess that is not compared yet. ``wait_s``: whole seconds until the next one is."""

    def __init__(self, wait_s: float) -> None:
        self.wait_s = max(1, math.ceil(wait_s))
        super().__init__(f"not before {self.wait_s} s from now")


@dataclass(slots=True)
class _Guesser:
    count: int = 0
    latest_s: float = -math.inf
    next_s: float = -math.inf
    digests: set[bytes] = field(default_factory=set)


class Guesses:
    """Guesses of each address or operator. A guess counts as wrong until :meth:`accept` is called.

    So guesses that are checked at the same time count too. The same guess again does not count, as it tells nothing
    new: a page that keeps sending an outdated token locks nobody out.

    Parameters
    ----------
    clock : returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._guessers: OrderedDict[Hashable, _Guesser] = OrderedDict()
        self._key = secrets.token_bytes(32)  # a PIN is not kept in memory

    def admit(self, guesser: Hashable, guess: str) -> None:
        """Count a guess before it is compared. TooManyGuessesError if it has to wait: then it is not counted."""
        now_s = self._clock()
        record = self._guessers.setdefault(guesser, _Guesser())
        self._guessers.move_to_end(guesser)
        if now_s - record.latest_s > _FORGET_S:
            record = self._guessers[guesser] = _Guesser()
        digest = hmac.digest(self._key, guess.encode("utf-8", "surrogatepass"), hashlib.sha256)
        if digest in record.digests:
            return
        if now_s < record.next_s:
            raise TooManyGuessesError(record.next_s - now_s)
        record.count += 1
        record.latest_s = now_s
        if len(record.digests) < _MAX_GUESSES:
            record.digests.add(digest)
        if record.count >= FREE_GUESSES:
            record.next_s = now_s + min(2.0 ** min(record.count - FREE_GUESSES, 16), LONGEST_WAIT_S)
        while len(self._guessers) > _MAX_GUESSERS:
            self._guessers.popitem(last=False)

    def accept(self, guesser: Hashable) -> None:
        """Forget the guesses of somebody who gave the right token or PIN, or was not asked for one."""
        self._guessers.pop(guesser, None)


def client_network(address: str) -> str:
    """Return the name of one client: an IPv4 address, or the /64 network of an IPv6 address."""
    try:
        parsed = ip_address(address)
    except ValueError:
        return address
    if isinstance(parsed, IPv6Address):
        return str(parsed.ipv4_mapped or ip_network((parsed, 64), strict=False))
    return str(parsed)
