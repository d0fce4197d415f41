"""Request for a gauge study: sensors, stations, metrics, tolerances and days.

It comes from options, or from a study's file, whose lines are then named in refusals.
"""

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.tables import FileModel, validate
from cbsr_qa.config.text import line_of
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.fleet import MetricKey, RunSelection
from cbsr_qa.plugin.problems import Problem, Table
from cbsr_qa.studies.gauge.references import ReferenceTable, ReferenceValue
from cbsr_qa.system.words import KeyPath, echo, format_key_path

#: Possible appraisers.
APPRAISERS = ("station", "operator")
#: What may be nested in the appraiser: sensors, or batches whose sensors a test destroys.
NESTED = ("sensor", "batch")
_EVERY: Final = RunSelection()


@dataclass(frozen=True, slots=True)
class StudySource:
    """The file of a study with the digest of its text, for finding lines."""

    name: str
    file: str
    sha256: str
    text: Annotated[str, Field(exclude=True)]


@dataclass(frozen=True, slots=True)
class MetricWanted:
    """One metric of a study.

    Parameters
    ----------
    phase : empty for any.
    qualifier : exactly this one; None for any.
    unit : required of the metric; empty if no number here depends on it.
    lower, upper, tolerance : limits, or their width alone; all None for those of the recipe.
    """

    name: str
    phase: str = ""
    qualifier: str | None = None
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    tolerance: float | None = None

    def means(self, key: MetricKey) -> bool:
        """Whether it includes a measured value."""
        fits = self.phase in ("", key.phase) and self.qualifier in (None, key.qualifier)
        return self.name == key.name and fits

    @property
    def width(self) -> float | None:
        """The tolerance stated here; None to use the recipe's."""
        if self.lower is not None and self.upper is not None:
            return self.upper - self.lower
        return self.tolerance


@dataclass(frozen=True, slots=True)
class GaugeRequest:
    """Subject of a study.

    Parameters
    ----------
    runs : selection by serials, a recipe or both.
    metrics : empty for those limited by the recipe.
    by_location : True for one study per location, False for one study of the mean over all.
    appraiser : ``"station"`` or ``"operator"``.
    largest_balanced : use the largest balanced part of an incomplete crossing.
    nested : each appraiser's own parts, ``"sensor"`` or ``"batch"``; None for a crossed study.
    references : true values of golden sensors.
    source : the file this was read from; None for options.
    """

    runs: RunSelection = _EVERY
    metrics: tuple[MetricWanted, ...] = ()
    by_location: bool = False
    appraiser: str = "station"
    largest_balanced: bool = False
    nested: str | None = None
    references: tuple[ReferenceValue, ...] = ()
    confidence: float = 0.95
    source: StudySource | None = None

    def locate(self, *path: str | int) -> str:
        """Line and key of the study's file that a refusal concerns; empty for options."""
        if self.source is None:
            return ""
        line = line_of(self.source.text, path)
        return f"{self.source.file}{f' line {line}' if line else ''}: {format_key_path(path)}: "

    def check(self) -> None:
        """Check the request before anything is read.

        RefusedError if no runs are selected, the appraiser, the nested part or the confidence is not allowed, or a
        nested study is to be balanced.
        """
        if self.appraiser not in APPRAISERS:
            raise RefusedError(f"--appraiser is {echo(self.appraiser)}", remedy=f"allowed: {', '.join(APPRAISERS)}")
        if self.nested is not None and self.nested not in NESTED:
            raise RefusedError(f"--nested is {echo(self.nested)}", remedy=f"allowed: {', '.join(NESTED)}")
        if self.nested is not None and self.largest_balanced:
            raise RefusedError(
                "--largest-balanced is for crossed studies, and this one is nested",
                remedy="choose the sensors of a balanced study by --serials",
            )
        if not 0.5 < self.confidence < 1:
            raise RefusedError(
                f"confidence is {100 * self.confidence:g} %",
                remedy="allowed: above 50 and below 100 %; give per cent, 95 for 95 %",
            )
        if not self.runs.serials and self.runs.recipe is None:
            raise RefusedError(
                "no study is named", remedy="name a study's file, or choose runs by --serials S1,S2,… or --recipe R"
            )


_Name = Annotated[str, Field(min_length=1, max_length=64)]
_Names = Annotated[list[_Name], Field(min_length=1)]


class StudyTable(Table):
    """``[study]``: which runs, and how they are looked at."""

    name: _Name
    recipe: _Name | None = None
    serials: _Names | None = None
    stations: _Names | None = None
    operators: _Names | None = None
    since: date | None = None
    until: date | None = None
    appraiser: Literal["station", "operator"] = "station"
    by_location: bool = False
    largest_balanced: bool = False
    nested: Literal["sensor", "batch"] | None = None
    confidence_percent: float = 95.0

    def problems(self) -> Iterator[Problem]:
        if not self.name.isprintable():
            yield Problem(("study", "name"), "has characters that cannot be printed; give one line")
        if self.recipe is None and self.serials is None:
            yield Problem(("study",), "has neither recipe nor serials; give one of them, or both")
        if self.nested and self.largest_balanced:
            problem = "is true in a nested study; it is for crossed ones"
            yield Problem(("study", "largest_balanced"), problem)
        if not 50 < self.confidence_percent < 100:
            problem = f"is {self.confidence_percent:g}; allowed: above 50 and below 100, in per cent (95 for 95 %)"
            yield Problem(("study", "confidence_percent"), problem)
        if self.since and self.until and self.since > self.until:
            yield Problem(("study", "since"), f"is {self.since}, after until = {self.until}")
        for key in ("serials", "stations", "operators"):
            names = getattr(self, key) or []
            for name, count in Counter(names).items():
                if count > 1:
                    yield Problem(("study", key), f"has {name!r} {count} times; give it once")


class MetricTable(Table):
    """``[[metrics]]``: one metric, with the tolerance for its gauge; by default the recipe's."""

    name: _Name
    phase: Annotated[str, Field(max_length=64)] = ""
    qualifier: Annotated[str, Field(max_length=64)] = ""
    unit: Annotated[str, Field(min_length=1, max_length=16)] | None = None
    lower: float | None = None
    upper: float | None = None
    tolerance: Annotated[float, Field(gt=0)] | None = None

    def problems(self, where: KeyPath) -> Iterator[Problem]:
        numbers = [key for key in ("lower", "upper", "tolerance") if getattr(self, key) is not None]
        if numbers and self.unit is None:
            yield Problem((*where, "unit"), f"is missing: {' and '.join(numbers)} of {self.name} must have one")
        if (self.lower is None) != (self.upper is None):
            other = "upper" if self.upper is None else "lower"
            problem = f"has no {other}; a tolerance is from lower to upper, or give its width as tolerance"
            yield Problem((*where, numbers[0]), problem)
        if self.tolerance is not None and len(numbers) > 1:
            yield Problem((*where, "tolerance"), "is given beside lower or upper; give the one or the others")
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            yield Problem((*where, "lower"), f"is {self.lower:g}, not below upper = {self.upper:g}")

    def overlaps(self, other: "MetricTable") -> bool:
        same = (self.name, self.qualifier) == (other.name, other.qualifier)
        return same and (self.phase == other.phase or not self.phase or not other.phase)

    def to_domain(self) -> MetricWanted:
        return fill_from_object(MetricWanted, self, unit=self.unit or "")


class StudyFile(FileModel[GaugeRequest]):
    """A study's file."""

    study: StudyTable
    metrics: Annotated[list[MetricTable], Field(min_length=1)] | None = None
    reference: Annotated[list[ReferenceTable], Field(min_length=1)] | None = None

    def problems(self) -> Iterator[Problem]:
        """Yield contradictions: named items must be part of the study, and only once."""
        yield from self.study.problems()
        metrics: Sequence[MetricTable] = self.metrics or ()
        for index, metric in enumerate(metrics):
            yield from metric.problems(("metrics", index))
            if any(metric.overlaps(other) for other in metrics[:index]):
                yield Problem(("metrics", index, "name"), f"is {metric.name!r}, which is studied already")
        yield from self._reference_problems()

    def _reference_problems(self) -> Iterator[Problem]:
        serials, seen_pairs = self.study.serials, set()
        names = [metric.name for metric in self.metrics or ()]
        for index, reference in enumerate(self.reference or ()):
            key = ("reference", index)
            if serials is not None and reference.serial not in serials:
                problem = f"is {reference.serial!r}, which is not in study.serials: {', '.join(serials)}"
                yield Problem((*key, "serial"), problem)
            if names and reference.metric not in names:
                problem = f"is {reference.metric!r}, which is not among the metrics: {', '.join(names)}"
                yield Problem((*key, "metric"), problem)
            if (reference.serial, reference.metric) in seen_pairs:
                yield Problem(
                    (*key, "serial"), f"is {reference.serial!r}, which has a value of {reference.metric} already"
                )
            seen_pairs.add((reference.serial, reference.metric))

    def to_domain(self) -> GaugeRequest:
        """Return the request, with per cent as a fraction."""
        study = self.study
        names = {key: tuple(getattr(study, key) or ()) for key in ("serials", "stations", "operators")}
        return fill_from_object(
            GaugeRequest,
            study,
            runs=fill_from_object(RunSelection, study, **names),
            metrics=tuple(metric.to_domain() for metric in self.metrics or ()),
            references=tuple(reference.to_domain() for reference in self.reference or ()),
            confidence=study.confidence_percent / 100,
            source=StudySource(study.name, "", "", ""),
        )


def read_study(path: Path) -> GaugeRequest:
    """Read a study's file.

    Raises
    ------
    ConfigError
        If the file does not exist, is not TOML, or has entries that are not allowed: every problem with its line.
    """
    document = open_document(DocumentKind.GAUGE_STUDY, path)
    request = validate(StudyFile, document)
    assert request.source is not None
    digest = hashlib.sha256(document.text.encode()).hexdigest()
    return replace(request, source=StudySource(request.source.name, document.label, digest, document.text))
