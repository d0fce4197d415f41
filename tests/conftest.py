"""What every test may use."""

import gc
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

import hypothesis
import pytest
import sqlalchemy as sa
from drawn import drawn
from made_once import share
from shared_statements import share_statements

# As the command line does, before numpy is loaded: several workers with several threads each are far slower.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

# A shell has what it puts in the background ignore some signals, and programs started from there do too: tests of
# signals would then wait for what never comes.
for _name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP", "SIGQUIT"):
    _number = getattr(signal, _name, None)
    if _number is not None and signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, signal.default_int_handler if _name == "SIGINT" else signal.SIG_DFL)

# Of properties that do not say how many examples they are tried on.
hypothesis.settings.register_profile("tier", drawn())
hypothesis.settings.load_profile("tier")

share_statements()

# Fixtures that tests of several rooms use.
pytest_plugins = ["round_sensors", "shared_recordings"]

_SHARED = Path(__file__).resolve().parents[2] / "shared"


def pytest_collection_finish() -> None:
    """Leave what is collected out of later collections of garbage, which took a quarter of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(5_000, 10, 10)


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real recordings and reference numbers; skips, saying so, where it is absent."""
    if not (_SHARED / "data").is_dir():
        pytest.skip(f"the recordings and reference numbers are not at {_SHARED}")
    return _SHARED


@pytest.fixture(scope="session", autouse=True)
def _shared_by_workers(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Workers of one run of the tests make some things once for all of them."""
    folder = tmp_path_factory.getbasetemp()
    share((folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "made once")


class PostgresServer:
    """The PostgreSQL server of this machine, in which tests make databases and drop them."""

    def __init__(self) -> None:
        self._engine = sa.create_engine(
            "postgresql+psycopg://postgres@127.0.0.1:5432/postgres",
            isolation_level="AUTOCOMMIT",
            connect_args={"connect_timeout": 3},
        )

    def execute(self, statement: str) -> None:
        """Carry out one statement as the server's owner, in no transaction."""
        with self._engine.connect() as connection:
            connection.exec_driver_sql(statement)

    @contextmanager
    def new_database(self) -> Iterator[str]:
        """Make an empty database, give its address, and drop it; a connection left open to it is an error."""
        name = f"cbsr_qa_test_{uuid4().hex}"
        self.execute(f"CREATE DATABASE {name}")
        try:
            yield f"postgresql://postgres@127.0.0.1:5432/{name}"
            self.execute(f"DROP DATABASE {name}")
        finally:
            self.execute(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")

    def dispose(self) -> None:
        """Leave the server."""
        self._engine.dispose()


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    """The PostgreSQL server of this machine; skips, saying so, where none answers."""
    server = PostgresServer()
    try:
        server.execute("SELECT 1")
    except sa.exc.OperationalError as error:
        server.dispose()
        pytest.skip(f"no PostgreSQL server answers at 127.0.0.1:5432: {error.orig}")
    yield server
    server.dispose()


@pytest.fixture
def postgres_database(postgres_server: PostgresServer) -> Iterator[str]:
    """Address of an empty database on the server, dropped after the test."""
    with postgres_server.new_database() as url:
        yield url


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Address of an empty database of each kind that is supported."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'runs.db'}"
    return str(request.getfixturevalue("postgres_database"))


@pytest.fixture
def in_zurich(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """This computer's clock is that of Zürich."""
    monkeypatch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()
