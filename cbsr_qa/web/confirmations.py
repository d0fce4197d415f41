"""After an emergency stop or a fault somebody says that the bench is safe; before that, its station is not ready."""

from cbsr_qa.app.run.control import is_confirmed, read_confirmer
from cbsr_qa.domain.run.states import EndReason, was_emergency
from cbsr_qa.store.runs.live import RunLook


def name_confirmer(look: RunLook) -> str:
    """Return who confirmed the bench after the latest session of a run; empty for nobody."""
    return read_confirmer(look.run, look.session_at, look.station)


def needs_confirmation(look: RunLook) -> bool:
    """Whether the latest session of a run ended at once or by a fault, and nobody has confirmed the bench since.

    ``cbsr-qa run`` asks for it after an emergency stop only: after a fault, somebody at a terminal has seen it.
    """
    ended_badly = look.end is EndReason.BROKEN or (look.end is EndReason.ABORTED and was_emergency(look.detail))
    return ended_badly and not is_confirmed(look.run, look.session_at)
