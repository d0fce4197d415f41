"""After an emergency stop or a fault somebody says that the bench is safe; before that, its station is not ready."""

from datetime import UTC, datetime
from pathlib import Path

from cbsr_qa.config.paths import var_folder, writable_folder
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.run.states import EndReason, was_emergency
from cbsr_qa.store.runs.live import RunLook
from cbsr_qa.web.guard import LOG


def needs_confirmation(look: RunLook) -> bool:
    """Whether the latest session of a run ended at once or by a fault, and nobody has confirmed the bench since."""
    ended_badly = look.end is EndReason.BROKEN or (look.end is EndReason.ABORTED and was_emergency(look.detail))
    return ended_badly and not _file_of(look).exists()


def confirm_bench(look: RunLook, by: str) -> None:
    """Store that the bench is safe after the latest session of a run, and who says so.

    ConfigError if it cannot be stored.
    """
    file = _file_of(look)
    writable_folder(file.parent)
    try:
        file.write_text(f"{look.station}: {by}, {datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{file} cannot be written: {error.strerror or error}") from error
    LOG.info("%s: %s confirmed that the bench is safe after run %s", look.station, by, look.run)


def _file_of(look: RunLook) -> Path:
    """Return the file that confirms a session: a run that is resumed may be stopped at once again."""
    return var_folder() / "control" / "confirmed" / f"{look.run}-{look.session_at:%Y%m%dT%H%M%S%f}"
