"""Keys that sign calibrations (Ed25519, RFC 8032), in PEM files: the private one in PKCS #8, the public one as SPKI.

The library ``cryptography`` (extra ``sign``) is loaded only if a key is made, or a file is signed or checked.
"""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.system.files import writing
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.system.secret import secret_of

PASSPHRASE: Final = "CBSR_QA_KEY_PASSPHRASE"
#: Suffix of the file with the public key, after the name of the other.
PUBLIC: Final = ".pub"
_LONGEST_BYTES: Final = 1023
_LARGEST_FILE: Final = 2**16
_REMEDY: Final = f"set {PASSPHRASE} to the passphrase, or to @FILE"
_MAKE: Final = "`cbsr-qa calibration keygen FILE` makes FILE, and FILE.pub with the public key"


def library(name: str) -> Any:
    """Return a module of ``cryptography``. RefusedError with the remedy if it is not installed."""
    from importlib import import_module

    try:
        return import_module(f"cryptography.{name}")
    except ImportError as error:
        raise RefusedError(
            "signatures of calibrations need cryptography, which is not installed",
            remedy="pip install 'cbsr-qa[sign]'",
        ) from error


class SigningKey:
    """A private key in memory; ``public_key`` is the other half, in hexadecimal digits.

    ``warnings`` say that others may read its file.
    """

    def __init__(self, key: Any, warnings: Sequence[str] = ()) -> None:
        self._key = key
        self.public_key: str = key.public_key().public_bytes_raw().hex()
        self.warnings = tuple(warnings)

    def sign(self, statement: bytes) -> str:
        """Return the signature of a statement, in hexadecimal digits."""
        return str(self._key.sign(statement).hex())


def passphrase(environment: Mapping[str, str] = os.environ) -> bytes | None:
    """Return the configured passphrase, or None. ConfigError if it is empty or too long, or its file unreadable."""
    phrase = secret_of(PASSPHRASE, remedy=_REMEDY, environment=environment)
    if phrase is None:
        return None
    secret = phrase.encode("utf-8", "surrogateescape")
    if not 1 <= len(secret) <= _LONGEST_BYTES:
        raise ConfigError(
            f"the passphrase in {PASSPHRASE} has {len(secret)} bytes; 1 to {_LONGEST_BYTES} are allowed",
            remedy=f"{_REMEDY}, or unset it for a key without one",
        )
    return secret


def new_key(path: Path) -> str:
    """Make a key pair: ``path``, which only its owner may read, and beside it the public key; return the latter.

    The private key is encrypted if a passphrase is configured.

    RefusedError if one of both files exists or cannot be written; neither is there then.
    """
    serial, ed25519 = library("hazmat.primitives.serialization"), library("hazmat.primitives.asymmetric.ed25519")
    secret = passphrase()
    lock = serial.NoEncryption() if secret is None else serial.BestAvailableEncryption(secret)
    key = ed25519.Ed25519PrivateKey.generate()
    public = key.public_key().public_bytes(serial.Encoding.PEM, serial.PublicFormat.SubjectPublicKeyInfo)
    _write_new(path, key.private_bytes(serial.Encoding.PEM, serial.PrivateFormat.PKCS8, lock), 0o600)
    try:
        _write_new(public_path(path), public, 0o644)
    except RefusedError:
        path.unlink()
        raise
    return SigningKey(key).public_key


def public_path(path: Path) -> Path:
    """Return where the public key of a private one is."""
    return path.with_name(path.name + PUBLIC)


def _write_new(path: Path, data: bytes, mode: int) -> None:
    with writing(path):
        try:
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        except FileExistsError:
            raise RefusedError(
                f"{path} exists already; a key is never replaced", remedy="name another file, or move it away first"
            ) from None
        try:
            with os.fdopen(file, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError:
            with suppress(OSError):
                path.unlink()
            raise


def signing_key(path: Path) -> SigningKey:
    """Read a private key.

    ConfigError if it cannot be read, needs another passphrase, or is of another type.
    """
    serial, ed25519 = library("hazmat.primitives.serialization"), library("hazmat.primitives.asymmetric.ed25519")
    data = _pem(path)
    if b" PUBLIC KEY-----" in data:
        raise ConfigError(f"key {path}: a public key, which cannot sign", remedy="give the file without .pub")
    try:
        try:
            key = serial.load_pem_private_key(data, None)
        except TypeError:  # encrypted
            secret = passphrase()
            if secret is None:
                raise ConfigError(f"key {path}: it has a passphrase, and none is set", remedy=_REMEDY) from None
            key = _unlock(path, data, secret, serial)
    except (ValueError, library("exceptions").UnsupportedAlgorithm) as error:
        raise _unreadable(path, "private") from error
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise _another_type(path, key)
    shared = os.name == "posix" and path.stat().st_mode & 0o077
    return SigningKey(key, [f"others than its owner may read or change key {path}: chmod 600"] if shared else ())


def _unlock(path: Path, data: bytes, secret: bytes, serial: Any) -> Any:
    try:
        return serial.load_pem_private_key(data, secret)
    except ValueError as error:
        raise ConfigError(
            f"key {path}: the passphrase in {PASSPHRASE} is not that of this key, or the file is damaged",
            remedy=_REMEDY,
        ) from error


def public_key(path: Path) -> str:
    """Read a public key; return it in hexadecimal digits.

    ConfigError if it cannot be read, is a private key, or is of another type.
    """
    serial, ed25519 = library("hazmat.primitives.serialization"), library("hazmat.primitives.asymmetric.ed25519")
    data = _pem(path)
    if b"PRIVATE KEY-----" in data:
        raise ConfigError(
            f"key {path}: a private key, where a public one is expected",
            remedy=f"give its public key ({path.name}{PUBLIC}); the private one stays where calibrations are signed",
        )
    try:
        key = serial.load_pem_public_key(data)
    except (ValueError, library("exceptions").UnsupportedAlgorithm) as error:
        raise _unreadable(path, "public") from error
    if not isinstance(key, ed25519.Ed25519PublicKey):
        raise _another_type(path, key)
    return str(key.public_bytes_raw().hex())


def _pem(path: Path) -> bytes:
    try:
        return read_foreign(path, _LARGEST_FILE)
    except OSError as error:
        raise ConfigError(f"key {path} cannot be read: {error.strerror or error}", remedy=_MAKE) from error


def _unreadable(path: Path, which: str) -> ConfigError:
    return ConfigError(f"key {path}: not a {which} key in PEM, or damaged", remedy=_MAKE)


def _another_type(path: Path, key: object) -> ConfigError:
    key_type = type(key).__name__.lstrip("_").removesuffix("PrivateKey").removesuffix("PublicKey")
    return ConfigError(f"key {path}: of the type {key_type}; calibrations are signed with Ed25519", remedy=_MAKE)
