"""Content of a report, independent of layout. Text stays text: escaping is the template's job."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from cbsr_qa.domain.plan.limits import LimitsVersion, Outcome
from cbsr_qa.domain.results.calibration import Calibration
from cbsr_qa.domain.results.characterisation import Characterisation
from cbsr_qa.domain.results.charts import StationCharts
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.run.changes import ChangeHistory, SensorHistory, VerdictOverride
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.station import StationCheck


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
    """

    title: str
    blocks: tuple[Block, ...]
    page_only: bool = False


@dataclass(frozen=True, slots=True)
class Banner:
    """The verdict at the top of the page.

    Parameters
    ----------
    tone : ``"pass"``, ``"marginal"``, ``"fail"``, ``"not-measured"`` or ``"plain"``; chooses the colours.
    symbol, headline, reason : a sign that survives a grey printer, the answer, and the one reason for it.
    """

    tone: str
    symbol: str
    headline: str
    reason: str


@dataclass(frozen=True, slots=True)
class Page:
    """Everything outside the sections.

    Parameters
    ----------
    kind : for example ``"Test report"``.
    subject : what it is about: a serial number, a file name.
    identity : (name, value) pairs, in reading order.
    simulated : what was simulated, in words; empty for a real bench.
    warnings : what may change a decision.
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
    exit_code : of the command.
    """

    result: R
    page: Page
    sections: tuple[Section, ...] = ()
    exit_code: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """A run with all its results: the input of a report section.

    Parameters
    ----------
    observation : None where the run ended before anything could be analysed.
    calibration : None if not issued; ``calibration_why`` then gives the reason.
    compute_s : seconds of computing by stage.
    limits_version : of those limits that carry one.
    characterisation : of the material, where the recipe is for that; there is no observation then.
    station_check : the station's latest one when the run began; None if never checked.
    station_charts : state of the station's control charts with this run; None without a reference.
    history : changes of the run's files since its sensor type last passed its recipe.
    overrides : decisions against the verdicts of the run, oldest first; ``verdict`` is not changed.
    sensor_history : runs of the sensor that began before this one; None if not loaded.
    missing : whether the run has no stored result; the verdict is then "not measured".
    """

    record: RunRecord
    observation: RunObservation | None
    measurements: tuple[Measurement, ...]
    verdict: Verdict
    calibration: Calibration | None
    calibration_why: str
    compute_s: tuple[tuple[str, float], ...] = ()
    warnings: tuple[str, ...] = field(default=())
    limits_version: LimitsVersion | None = None
    characterisation: Characterisation | None = None
    station_check: StationCheck | None = None
    station_charts: StationCharts | None = None
    history: ChangeHistory = field(default_factory=ChangeHistory)
    overrides: tuple[VerdictOverride, ...] = ()
    sensor_history: SensorHistory | None = None
    missing: bool = False
