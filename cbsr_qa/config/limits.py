"""Limits in recipes and in separate files, and their version.

The content of a file of limits that a recipe refers to is copied into the recipe, so that a stored run needs no file.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from cbsr_qa.config.documents import Document, DocumentKind, open_document
from cbsr_qa.config.tables import FileModel, Word, as_domain, refusal, validate
from cbsr_qa.config.text import line_of
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.numbers import did_you_mean
from cbsr_qa.domain.plan.limits import CODED_RULES, Limit, LimitsVersion, name_limit
from cbsr_qa.plugin.problems import Problem, Table

VersionName = Annotated[
    str,
    Field(
        min_length=1,
        max_length=64,
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="1 to 64 letters, digits and . _ -, starting with a letter or a digit",
    ),
]
Words = Annotated[str, Field(max_length=1000)]
Line = Annotated[
    str,
    Field(
        pattern=r"^\S([^\x00-\x1f\x7f]{0,198}\S)?$",
        description="one line of 1 to 200 characters without a blank at its ends",
    ),
]
Percent = Annotated[float, Field(gt=0, lt=100)]
Digest = Annotated[
    str, Field(pattern=r"^([0-9a-f]{64})?$", description="a SHA-256 of 64 digits and a to f, or empty")
]


class LimitTable(Table):
    """``[[limits]]``: inclusive bounds of one measurement in its own unit, with an optional guard band inside."""

    measurement: Word
    unit: Annotated[str, Field(min_length=1, max_length=16)]
    lower: float | None = None
    upper: float | None = None
    marginal: Annotated[float, Field(ge=0)] = 0.0
    phase: str = ""
    qualifier: str = ""
    version: VersionName | None = None

    @property
    def judges(self) -> tuple[str, str, str]:
        return self.measurement, self.phase, self.qualifier

    def problems(self, index: int, phases: Sequence[str] | None) -> Iterator[Problem]:
        """Yield contradictions within the table; ``phases`` of the recipe are None where they are unknown."""
        path = ("limits", index)
        if self.lower is None and self.upper is None:
            yield Problem(path, f"({self.measurement}) has neither lower nor upper; give one of them")
        if self.lower is not None and self.upper is not None and self.lower > self.upper:
            yield Problem((*path, "lower"), f"is {self.lower:g}, above upper = {self.upper:g}")
        if self.phase and phases is not None and self.phase not in phases:
            yield Problem((*path, "phase"), f"is {self.phase!r}; allowed: {', '.join(phases)}")

    def bounds_size_of(self, overlap: "LimitTable", phase: str) -> bool:
        """Whether this limit bounds, from both sides, the size of the blob whose overlap another limit judges.

        A lower bound of 0 or less does not bound the size.
        """
        fits = self.phase in ("", phase) and self.qualifier == overlap.qualifier
        return self.measurement == "area_ratio" and fits and (self.lower or 0.0) > 0 and self.upper is not None

    def to_domain(self) -> Limit:
        return as_domain(Limit, self, version=self.version or "")


class FailureCodeTable(Table):
    """An entry of ``[failure_codes]``: what a line calls a failure, and what it does with the sensor."""

    code: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,31}$",
            description="1 to 32 letters, digits and . _ -, starting with a letter or a digit",
        ),
    ]
    text: Line
    disposition: Line | Literal[""] = ""
    disposition_again: Line | Literal[""] = ""


def failure_code_problems(
    codes: Mapping[str, FailureCodeTable], limits: Sequence[LimitTable], phases: Sequence[str]
) -> Iterator[Problem]:
    """Yield codes of limits that the recipe does not have, and codes that mean two things."""
    names = [*dict.fromkeys(name_limit(*limit.judges) for limit in limits), *CODED_RULES]
    known = {*CODED_RULES}
    for measurement, phase, qualifier in (limit.judges for limit in limits):
        for in_phase in (phase,) if phase else ("", *phases):
            details = (in_phase, qualifier), ("", qualifier), (in_phase, ""), ("", "")
            known |= {name_limit(measurement, *pair) for pair in details}
    first_by_code: dict[str, str] = {}
    for cause, entry in codes.items():
        path = ("failure_codes", cause)
        if cause not in known:
            nearest = did_you_mean(cause, known)
            finding = "is no limit of this recipe, and no rule"
            yield Problem(path, finding, f"{nearest} allowed: {', '.join(names)}".lstrip())
        first = first_by_code.setdefault(entry.code, cause)
        meaning = codes[first]
        if meaning != entry:
            finding = f"is {entry.code!r}, which {first!r} gives the text {meaning.text!r}"
            finding += f" and the disposition {meaning.disposition!r}, again {meaning.disposition_again!r}"
            yield Problem((*path, "code"), finding, "one code has one meaning")


def size_problems(limits: Iterator[tuple[int, Mapping[str, Any]]], phases: Sequence[str]) -> Iterator[Problem]:
    """Yield limits on the overlap of blobs whose size is not limited too.

    A blob over the whole sheet overlaps by half, and so does a mere speck.

    Parameters
    ----------
    phases : phases in which single presses are held; the loads of loops have no overlap.
    """
    limit_by_index = {}
    for index, table in limits:
        with suppress(ValidationError):  # reported by the check of the whole file
            limit_by_index[index] = LimitTable.model_validate(table)
    for index, limit in limit_by_index.items():
        if limit.measurement != "area_overlap":
            continue
        for phase in phases:
            if limit.phase not in ("", phase) or any(
                other_limit.bounds_size_of(limit, phase) for other_limit in limit_by_index.values()
            ):
                continue
            yield Problem(
                ("limits", index),
                f"(area_overlap) judges phase {phase!r}, where no limit bounds area_ratio from both sides: a blob"
                " over the whole sheet, or one speck, overlaps by about 51 % and could pass; limit area_ratio"
                " there too (1/3 to 3 is usual), or remove this limit",
            )


class LimitsVersionTable(Table):
    """``[limits_version]``: origin of the limits with this ``version``. Written by ``cbsr-qa limits propose``."""

    version: VersionName
    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$", description="a date like 2027-03-31")]
    lot: Words = ""
    serials: list[str] = Field(default_factory=list)
    coverage_percent: Percent | None = None
    confidence_percent: Percent | None = None
    rule: Words = ""
    data_sha256: Digest = ""
    limits_sha256: Digest = ""

    def to_domain(self) -> LimitsVersion:
        """Return the version; a wrong seal was refused earlier."""
        return fill_from_object(LimitsVersion, self, sealed=bool(self.limits_sha256))


class LimitsFile(FileModel[None]):
    """A file of limits that recipes take in by ``limits_from``."""

    limits_version: LimitsVersionTable
    limits: Annotated[list[LimitTable], Field(min_length=1)]

    def problems(self) -> Iterator[Problem]:
        """Every limit must be of the file's version, and what the version says it is."""
        for index, limit in enumerate(self.limits):
            yield from limit.problems(index, None)
            if limit.version is None:
                yield Problem(("limits", index), f"({limit.measurement}) has no version; give the file's own")
        yield from version_problems(self.limits_version, self.limits)

    def to_domain(self) -> None:
        """Return nothing: a recipe includes the file's content and creates the limits."""


def version_problems(header: LimitsVersionTable | None, limits: Sequence[LimitTable]) -> Iterator[Problem]:
    """Yield inconsistencies between limits and their stated version."""
    for index, limit in enumerate(limits):
        if limit.version is not None and (header is None or limit.version != header.version):
            stated = f"limits_version.version is {header.version!r}" if header else "there is no [limits_version]"
            yield Problem(("limits", index, "version"), f"is {limit.version!r}, but {stated}")
    if header is None or not header.limits_sha256:
        return
    versioned = [limit for limit in limits if limit.version == header.version]
    if limits_digest([limit.model_dump() for limit in versioned]) != header.limits_sha256:
        yield Problem(
            ("limits_version", "limits_sha256"),
            f"is not that of the {len(versioned)} limits of version {header.version!r}: they were changed, added or"
            " left out after they were proposed; propose them again, or give yours a version name of their own"
            " and remove limits_sha256",
        )


def limits_digest(limits: Sequence[dict[str, Any]]) -> str:
    """Return the SHA-256 of limits as canonical JSON, independent of their order."""
    # Missing keys get their defaults first: whether a default is written out does not change the digest.
    whole_limits = [LimitTable.model_validate(limit).model_dump() for limit in limits]
    rows = sorted(json.dumps(limit, sort_keys=True, ensure_ascii=False) for limit in whole_limits)
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()


def with_limits(document: Document) -> Document:
    """Append the limits of the file ``recipe.limits_from``, next to the recipe, to its own limits; add the version.

    Raises
    ------
    ConfigError
        If the file cannot be read or is invalid, or if the recipe limits the same measurement itself.
    """
    recipe = document.data.get("recipe")
    name = recipe.get("limits_from") if isinstance(recipe, Mapping) else None
    if not isinstance(name, str):
        return document
    assert isinstance(recipe, Mapping)
    try:
        included = open_document(DocumentKind.LIMITS, name, near=document.folder)
        validate(LimitsFile, included)
    except ConfigError as error:
        line = line_of(document.text, ("recipe", "limits_from"))
        place = f"line {line}: " if line else ""
        raise ConfigError(
            f"{document.label}: {place}recipe.limits_from: {error.reason}", remedy=error.remedy
        ) from error
    own_limits = document.data.get("limits", [])
    problems = list(_find_duplicates(document, included, own_limits)) if isinstance(own_limits, list) else []
    if problems:
        raise refusal(document, problems)
    limits = [*own_limits, *included.data["limits"]] if isinstance(own_limits, list) else own_limits
    recipe_table = {key: value for key, value in recipe.items() if key != "limits_from"}
    version = included.data["limits_version"]
    return replace(
        document, data={**document.data, "recipe": recipe_table, "limits_version": version, "limits": limits}
    )


def _find_duplicates(document: Document, included: Document, own_limits: list[object]) -> list[Problem]:
    """List the limits, and the version, that both the recipe and the included file state."""
    problems = []
    if "limits_version" in document.data:
        problems.append(Problem(("limits_version",), f"is stated here and in {included.label}; remove this one"))
    included_judges = {_read_judged(limit) for limit in included.data["limits"]}
    for index, limit in enumerate(own_limits):
        if isinstance(limit, Mapping) and _read_judged(limit) in included_judges:
            finding = f"({limit.get('measurement')}) is limited in {included.label} too; remove one of them"
            problems.append(Problem(("limits", index), finding))
    return problems


def _read_judged(limit: Mapping[str, object]) -> tuple[object, object, object]:
    """Return what a raw limit judges: measurement, phase and qualifier, as :attr:`LimitTable.judges`."""
    return limit.get("measurement"), limit.get("phase", ""), limit.get("qualifier", "")
