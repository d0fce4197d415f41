"""Which stored runs to analyse again, how, and whether to adopt the results."""

from dataclasses import dataclass

from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.results.fleet import RunSelection


@dataclass(frozen=True, slots=True)
class ReanalyseRequest:
    """What to analyse again, how, and whether to adopt it.

    Parameters
    ----------
    recipe : file or name of a shipped one; None for each run's own.
    workers : processes on this computer; None for one for each processor.
    scheduler : address of a Dask scheduler, in place of processes; None without one.
    adopt, by, why : make the results the valid analyses; who decides, for what reason.
    fresh : compute again what is stored already.
    """

    selection: RunSelection
    recipe: str | None = None
    workers: int | None = None
    scheduler: str | None = None
    adopt: bool = False
    by: str = ""
    why: str = ""
    fresh: bool = False
    database: str | None = None

    def check(self) -> None:
        """Raise RefusedError or ConfigError if options contradict each other, or a decision has no name or reason."""
        if self.workers is not None and self.workers < 1:
            raise RefusedError(f"--workers {self.workers} is not a number of processes", remedy="give 1 or more")
        if self.workers is not None and self.scheduler is not None:
            raise RefusedError("--workers with --scheduler", remedy="a cluster has its own workers: give one of them")
        if not self.adopt:
            if self.by or self.why:
                raise RefusedError(
                    "--by and --why say who adopts, and why", remedy="give --adopt too, or leave them out"
                )
            return
        for option, text, missing_fact in (("--by", self.by, "who decides"), ("--why", self.why, "for what reason")):
            if not text.strip():
                raise ConfigError(f"--adopt needs {option}", remedy=f"say {missing_fact}")
        validate_operator(self.by)
        validate_reason(self.why)
