"""Override a verdict: a decision of a person, stored beside what was found."""

from dataclasses import dataclass
from typing import Any, Final

from cbsr_qa.app.decided_again import check_decided
from cbsr_qa.config.merge import restore
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.changes import VerdictOverride
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.outcome import Outcome
from cbsr_qa.store.repository import Repository, open_store

_OUTCOMES: Final = {"pass": Outcome.PASS, "fail": Outcome.FAIL}


@dataclass(frozen=True, slots=True)
class Overridden:
    """What was stored.

    Parameters
    ----------
    calibration : of the run, as it was issued; None where none was.
    """

    override: VerdictOverride
    calibration: str | None

    @property
    def about_calibration(self) -> str:
        """Say what becomes of the run's calibration."""
        if self.calibration is None:
            return "no calibration was issued, and an override issues none"
        if self.override.outcome is Outcome.FAIL:
            return (
                f"calibration {self.calibration} stays stored: an override withdraws none; take its file out of use"
            )
        return f"calibration {self.calibration} stays as it was issued"

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        return {**self.override.document(), "calibration": self.calibration, "note": self.about_calibration}


def override_verdict(run: str, outcome: str, *, by: str, why: str, database: str | None) -> Overridden:
    """Store a decision against the verdict of a run; nothing that was found is changed.

    Parameters
    ----------
    outcome : ``"pass"`` or ``"fail"``.
    by, why : who decides, and for what reason; neither may be empty.
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    ConfigError
        If the outcome, the name or the reason cannot be used.
    StoreError
        If there is no such run, it is not what was stored, or it has no verdict.
    """
    if outcome not in _OUTCOMES:
        raise ConfigError(f"a verdict cannot be overridden to {outcome!r}", remedy=f"allowed: {', '.join(_OUTCOMES)}")
    for option, text, what in (("--by", by, "who decides"), ("--why", why, "for what reason")):
        if not text.strip():
            raise ConfigError(f"an override needs {option}", remedy=f"say {what}")
    name, reason = validate_operator(by), validate_reason(why)
    with open_store(database_url(database), create=False) as store:
        _check_decided(store, run)
        made = store.override_verdict(run, _OUTCOMES[outcome], operator=name, why=reason)
        (analysis, *_) = store.analyses(run)
    return Overridden(made, analysis.calibration)


def _check_decided(store: Repository, run: str) -> None:
    """Refuse to decide against a verdict that does not follow from what is stored."""
    analyses = store.analyses(run)
    if analyses:
        limits = restore(store.configuration(run)).recipe.limits
        check_decided(store.load_run(run), analyses[0], limits)
