"""The one folder that all output goes to, its subfolders, and the address of the database."""

import errno
import os
import re
from collections.abc import Mapping
from pathlib import Path

from cbsr_qa.domain.errors import AT_COMMAND_LINE, ConfigError


def var_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Folder for all output: ``CBSR_QA_VAR``, or ``var`` in the current folder. Not created here."""
    return Path(environment.get("CBSR_QA_VAR") or "var")


def database_url(option: str | None = None, environment: Mapping[str, str] = os.environ) -> str:
    """Return the URL of the database: the option, else ``CBSR_QA_DATABASE``, else SQLite at ``var/cbsr-qa.db``.

    A plain path instead of a URL means a SQLite file there. ConfigError if the option is empty, as when a shell
    variable is not set: the default could be the database of another production line.
    """
    if option is not None and not option.strip():
        raise ConfigError("--database is empty", remedy="name a file or URL, or leave the option out for the default")
    chosen = option or environment.get("CBSR_QA_DATABASE") or str(var_folder(environment) / "cbsr-qa.db")
    return chosen if "://" in chosen else f"sqlite:///{chosen}"


def reports_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Folder for reports, below :func:`var_folder`."""
    return var_folder(environment) / "reports"


def calibrations_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Folder for calibration files, below :func:`var_folder`."""
    return var_folder(environment) / "calibrations"


def scenes_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Folder for recordings of simulated scenes, below :func:`var_folder`."""
    return var_folder(environment) / "scenes"


def materials_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Folder for material files of characterised materials, below :func:`var_folder`."""
    return var_folder(environment) / "materials"


def batches_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Folder for the models of batches, below :func:`var_folder`."""
    return var_folder(environment) / "batches"


def batch_file(batch: str, content_sha256: str) -> Path:
    """File of a batch's model in the folder of batches."""
    name = re.sub(r"[^\w.-]", "_", batch)
    return batches_folder() / f"{name}-{content_sha256[:16]}.json"


def check_folder(folder: Path) -> None:
    """Refuse a folder that could not be created or written to, without writing.

    Raises
    ------
    ConfigError
        If it could not; the message names the folder and the obstacle.
    """
    nearest_existing = next((path for path in (folder, *folder.absolute().parents) if os.path.lexists(path)), folder)
    if not nearest_existing.is_dir():
        raise _unwritable(folder, os.strerror(errno.ENOTDIR if nearest_existing.exists() else errno.ENOENT))
    if not os.access(nearest_existing, os.W_OK | os.X_OK):
        raise _unwritable(folder, os.strerror(errno.EACCES))


def writable_folder(folder: Path) -> Path:
    """Create a folder if need be, make sure that files can be written there, and return it.

    Raises
    ------
    ConfigError
        If it cannot be created or written to.
    """
    probe = folder / f".cbsr-qa-{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch(exist_ok=True)
        probe.unlink()
    except OSError as error:
        raise _unwritable(folder, error.strerror or str(error)) from error
    return folder


def _unwritable(folder: Path, why: str) -> ConfigError:
    return ConfigError(
        f"folder {folder} cannot be written to: {why}",
        remedy="allow writing there, or choose another one\n"
        f"{AT_COMMAND_LINE}CBSR_QA_VAR names it, for the database --database",
    )
