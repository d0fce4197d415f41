"""Commands that continue from what is stored, naming a database other than the default; and how to start one."""

import shlex
import sys

from cbsr_qa.config.paths import database_url
from cbsr_qa.store.damage import address
from cbsr_qa.store.engine import parse_url
from cbsr_qa.store.repository import Repository


def database_option(database: str | None) -> str:
    """Return the option that names a database, a password in it hidden, after a blank; empty if none was named."""
    if not database:
        return ""
    url = parse_url(database_url(database))
    return f" --database {shlex.quote(database if url.get_backend_name() == 'sqlite' else address(url))}"


def resume_command(run: str, store: Repository) -> str:
    """Return the command that resumes a run."""
    return f"cbsr-qa run --resume {run}{_unless_usual(store)}"


def report_command(run: str, store: Repository) -> str:
    """Return the command that writes a run's report and calibration file again."""
    return f"cbsr-qa report {run}{_unless_usual(store)}"


def _unless_usual(store: Repository) -> str:
    return database_option(None if store.is_at(database_url()) else store.address)


def build_own_command(*arguments: str) -> list[str]:
    """Return what starts a command of this program in a process of its own, with the same interpreter."""
    return [sys.executable, "-c", "from cbsr_qa.cli.main import entry; entry()", *arguments]
