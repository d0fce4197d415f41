"""Content of a report, independent of layout. Text stays text: escaping is the template's job."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from cbsr_qa.domain.plan.limits import Outcome


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Plain text; ``tone`` is ``"plain"``, ``"note"`` or ``"warning"``."""

    text: str
    tone: str = "plain"


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell of a table; ``outcome`` colours it."""

    text: str
    outcome: Outcome | None = None


@dataclass(frozen=True, slots=True)
class Table:
    """Columns and rows, with a caption that says what to look at.

    Parameters
    ----------
    numeric : indices of columns that hold numbers (set to the right).
    folded : long and rarely read: shown as its caption until it is unfolded, and not printed while it is folded.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    numeric: tuple[int, ...] = ()
    folded: bool = False


@dataclass(frozen=True, slots=True)
class Figure:
    """An inline SVG with a caption and a text alternative.

    Parameters
    ----------
    svg : the ``<svg>`` element, made by :mod:`cbsr_qa.report` from numbers and escaped text only; or what draws it,
        which is called only where the figure is shown.
    """

    caption: str
    alternative: str
    svg: str | Callable[[], str]


Block = Paragraph | Table | Figure


@dataclass(frozen=True, slots=True)
class Section:
    """One section of a report.

    Parameters
    ----------
    page_only : explains what the reader of a page cannot ask; a terminal does not show it.
    leaf : number of the leading page of a run's report that it stands on; None in the annex.
    """

    title: str
    blocks: tuple[Block, ...]
    page_only: bool = False
    leaf: int | None = None


@dataclass(frozen=True, slots=True)
class Banner:
    """The verdict at the top of the page.

    Parameters
    ----------
    tone : ``"pass"``, ``"marginal"``, ``"fail"``, ``"not-measured"`` or ``"plain"``; chooses the colours.
    symbol, headline, reason : a sign that survives a grey printer, the answer, and the one reason for it.
    actions, remark : what is done now, and what else counts for that; in the banner of a page, not of a terminal.
    """

    tone: str
    symbol: str
    headline: str
    reason: str
    actions: tuple[str, ...] = ()
    remark: str = ""


@dataclass(frozen=True, slots=True)
class Page:
    """Everything outside the sections.

    Parameters
    ----------
    kind : kind of page, for example ``"Test report"``.
    subject : subject of the page: a serial number, a file name.
    identity : (name, value) pairs, in reading order.
    simulated : simulated parts in words; empty for a real bench.
    warnings : warnings that may change a decision.
    remarks : worth knowing, nothing to worry about.
    printed : (name, value) pairs for a terminal alone, never wrapped: files, and commands to type.
    """

    kind: str
    subject: str
    banner: Banner
    identity: tuple[tuple[str, str], ...]
    simulated: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    printed: tuple[tuple[str, str], ...] = ()


R = TypeVar("R")


@dataclass(frozen=True, slots=True, eq=False)
class CommandOutcome(Generic[R]):
    """The outcome of a command, for HTML page, terminal and ``--json`` alike.

    Parameters
    ----------
    result : a dataclass whose field names are the documented JSON keys.
    page, sections : content for people.
    exit_code : exit code of the command.
    """

    result: R
    page: Page
    sections: tuple[Section, ...] = ()
    exit_code: int = 0
