"""Open a database that is up to date, or say why it cannot be used."""

from collections.abc import Callable
from datetime import datetime

from cbsr_qa.store import schema
from cbsr_qa.store.chain.links import KEY_OPTION, SigningKey
from cbsr_qa.store.engine import leave_engine, open_engine, parse_url, use_engine
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.clock import RealClock


def open_store(
    url: str,
    *,
    create: bool = True,
    durable: bool = True,
    wall: Callable[[], datetime] | None = None,
    tell: Callable[[str], None] | None = None,
) -> Repository:
    """Open a database that is up to date.

    Parameters
    ----------
    url : SQLAlchemy URL, see :func:`cbsr_qa.config.paths.database_url`.
    create : create missing tables.
    durable : wait for the disk at every commit, see :func:`cbsr_qa.store.engine.open_engine`.
    wall : clock for identifiers and analyses; by default the computer's.
    tell : function called while another program creates the tables.

    Raises
    ------
    StoreError
        If it is missing (and not to be created), damaged, of another version or program, or unreachable.
    ConfigError
        If the configured signing key cannot be used, see :mod:`cbsr_qa.store.chain.links`.
    """
    opened = _open(url, create=create, durable=durable, wall=wall, tell=tell)
    if opened is None:
        engine = open_engine(parse_url(url))
        raise schema.refusal(engine, schema.SchemaVersion(schema.Age.EMPTY, None))
    return opened


def open_existing(url: str) -> Repository | None:
    """Open a database that exists, and create nothing; None if it does not exist. Raises like :func:`open_store`."""
    return _open(url, create=False)


def _open(
    url: str,
    *,
    create: bool,
    durable: bool = True,
    wall: Callable[[], datetime] | None = None,
    tell: Callable[[str], None] | None = None,
) -> Repository | None:
    key = SigningKey.from_environment()
    engine = use_engine(parse_url(url), durable=durable).execution_options(**{KEY_OPTION: key})
    try:
        version = schema.read_version(engine)
        if version.age is schema.Age.EMPTY:
            if not create:
                leave_engine(engine)
                return None
            schema.upgrade(engine, tell=tell)
        elif version.age is not schema.Age.CURRENT:
            raise schema.refusal(engine, version)
    except BaseException:
        leave_engine(engine)
        raise
    return Repository(engine, wall or RealClock().wall)


def check_usable(url: str) -> None:
    """Refuse a database that could not store a run; anything written to find out is removed.

    Raises
    ------
    StoreError
        If it cannot be reached or written, is of another version, or is another program's.
    """
    engine = use_engine(parse_url(url))
    try:
        version = schema.read_version(engine)
        if version.age not in (schema.Age.EMPTY, schema.Age.CURRENT):
            raise schema.refusal(engine, version)
        schema.check_writable(engine, version)
    finally:
        leave_engine(engine)
