"""One row of the table: what was to be reached, what was, and what a peer does in the same run."""

from dataclasses import dataclass

from benchmarks.timing import Compared, shown


@dataclass(frozen=True)
class Row:
    """A figure against its goal.

    Parameters
    ----------
    what : is measured, with sizes.
    goal : to reach, in words; empty for a figure that is only reported.
    here : what was measured.
    peer : result of other software in the same run, or its published value with the source.
    met : whether the goal is reached; None without one.
    """

    what: str
    goal: str
    here: str
    peer: str = ""
    met: bool | None = None

    def markdown(self) -> str:
        verdict = {True: "reached", False: "**not reached**", None: ""}[self.met]
        return f"| {self.what} | {self.goal} | {self.here} | {self.peer} | {verdict} |"


def ratio_row(compared: Compared, goal: float | None = None) -> Row:
    """Row of two times, of which the other way must be slower by a factor."""
    met = None if goal is None else compared.ratio >= goal
    return Row(
        compared.what,
        "" if goal is None else f"≥ {goal:g} × faster",
        f"{compared.ours}: {shown(compared.ours_s)}, {compared.ratio:.1f} × faster",
        f"{compared.theirs}: {shown(compared.theirs_s)}",
        met,
    )
