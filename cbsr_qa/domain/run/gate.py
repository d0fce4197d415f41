"""Answers of the checks before a run, stored with it; and releases of configuration files."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from typing import Literal

from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy


class GateOutcome(StrEnum):
    """Outcome of one check."""

    PASSED = "passed"
    WARNED = "warned"
    REFUSED = "refused"
    OVERRIDDEN = "overridden"  #: it would have refused the run
    OFF = "off"  #: not asked, or nothing to ask


@dataclass(frozen=True, slots=True)
class GateAnswer:
    """Answer of one check.

    Parameters
    ----------
    words : finding as a clause that begins in lower case or with a name.
    remedy : remedy; empty where nothing needs doing.
    by, why : person who overrode a refusal, and the reason; empty otherwise.
    session : 0 when the run began; counts its resumptions.
    command : command that does the remedy; not stored.
    """

    check: GateCheck
    policy: GatePolicy
    outcome: GateOutcome
    words: str
    remedy: str = ""
    by: str = ""
    why: str = ""
    session: int = 0
    command: str = ""

    @property
    def instruction(self) -> str:
        """The remedy as it is done at the command line."""
        return ": ".join(filter(None, [self.remedy, self.command]))

    @property
    def sentence(self) -> str:
        """The finding, and who overrode it."""
        overridden = f"; overridden by {self.by}: {self.why}" if self.outcome is GateOutcome.OVERRIDDEN else ""
        return f"{self.words}{overridden}"


def gate_warnings(answers: Iterable[GateAnswer]) -> tuple[str, ...]:
    """Return a warning for every check that did not pass."""
    noted = (GateOutcome.WARNED, GateOutcome.OVERRIDDEN)
    return tuple(f"gate, {answer.check}: {answer.sentence}" for answer in answers if answer.outcome in noted)


@dataclass(frozen=True, slots=True)
class Release:
    """Somebody released a configuration file, or withdrew it; the latest of a kind and digest holds.

    Parameters
    ----------
    kind, name : kind and name of the file: ``"recipe"``, ``"nine-locations"``.
    sha256 : digest of its content.
    """

    release: str
    kind: str
    name: str
    sha256: str
    action: Literal["released", "withdrawn"]
    by: str
    why: str
    at: datetime
