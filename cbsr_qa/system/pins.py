"""PINs of operators as salted hashes (scrypt, RFC 7914).

A hash reads ``scrypt:<log2 N>:<r>:<p>:<salt>:<key>``, both in hexadecimal. A PIN never reaches a log or a message.
"""

import hashlib
import hmac
import os
import re
from typing import Final

#: Cost of a new hash: 16 MB and about 50 ms for each try.
_COST: Final = (14, 8, 1)
#: Highest cost accepted in a file: a hash must not take all memory of the station.
_HIGHEST: Final = (18, 16, 4)
_FORM: Final = re.compile(r"scrypt:(\d{1,2}):(\d{1,2}):(\d{1,2}):([0-9a-f]{16,64}):([0-9a-f]{64})")
SHORTEST_PIN: Final = 4
LONGEST_PIN: Final = 64


def pin_allowed(pin: str) -> bool:
    """Whether a text can be a PIN: 4 to 64 printable characters without a space at either end."""
    return SHORTEST_PIN <= len(pin) <= LONGEST_PIN and pin.isprintable() and pin == pin.strip()


def hash_pin(pin: str) -> str:
    """Return the hash of a PIN with a new salt."""
    salt = os.urandom(16)
    return ":".join(("scrypt", *map(str, _COST), salt.hex(), _key(pin, salt, *_COST).hex()))


def pin_hash_readable(text: object) -> bool:
    """Whether a value is a hash of :func:`hash_pin`, of a cost that this station can pay."""
    fields = _FORM.fullmatch(text) if isinstance(text, str) else None
    if fields is None:
        return False
    return all(1 <= int(cost) <= highest for cost, highest in zip(fields.groups()[:3], _HIGHEST, strict=True))


def pin_matches(pin: str, hashed: str) -> bool:
    """Whether a hash is of this PIN; compared in constant time."""
    fields = _FORM.fullmatch(hashed)
    if fields is None or not pin_hash_readable(hashed) or len(pin) > LONGEST_PIN:
        return False
    cost, r, p = (int(number) for number in fields.groups()[:3])
    key = _key(pin, bytes.fromhex(fields[4]), cost, r, p)
    return hmac.compare_digest(key, bytes.fromhex(fields[5]))


def _key(pin: str, salt: bytes, cost: int, r: int, p: int) -> bytes:
    memory = 128 * r * (2**cost + p + 2)
    secret = pin.encode("utf-8", "surrogateescape")
    return hashlib.scrypt(secret, salt=salt, n=2**cost, r=r, p=p, maxmem=2 * memory, dklen=32)
