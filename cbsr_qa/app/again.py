"""Commands that go on with something stored, as a user types them; a database that is not the usual one is named."""

from cbsr_qa.config.paths import database_url
from cbsr_qa.store.repository import Repository


def resume_command(run: str, store: Repository) -> str:
    """Return what goes on with a run."""
    return f"cbsr-qa run --resume {run}{database_option(store)}"


def report_command(run: str, store: Repository) -> str:
    """Return what writes a run's report and calibration file again."""
    return f"cbsr-qa report {run}{database_option(store)}"


def database_option(store: Repository) -> str:
    """Return the option that names a database, after a blank; empty where it is found without."""
    if store.is_at(database_url()):
        return ""
    return f" --database {store.address}"
