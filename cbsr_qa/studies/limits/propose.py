"""Limits and guard bands from a golden lot: read from the store, proposed, written to a file for a recipe."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, Final

from cbsr_qa.config.limits import limits_digest
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.text import toml_document
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.report.tables import plural
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.limits.golden_lot import Lot, LotChoice, gather
from cbsr_qa.studies.limits.groups import groups_of
from cbsr_qa.studies.limits.proposals import NoLimit, ProposedLimit, Terms, propose
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.words import echo

RULE: Final = (
    "a value beyond a limit fails; one inside by less than the guard band passes marginally, because its uncertainty"
    " reaches beyond the limit; any other passes (JCGM 106:2012, 8.3.2); guard band = {factor:g} × expanded"
    " uncertainty"
)
#: Reason why a recipe may refuse a limit on the overlap.
SIZELESS: Final = "{label}: a recipe takes this in only with area_ratio limited there too, above 0 and on both sides"


@dataclass(frozen=True, slots=True, eq=False)
class ProposedLimits:
    """Proposed limits of a golden lot.

    Parameters
    ----------
    version : name of these limits.
    coverage, confidence : share of good sensors within each limit by itself, and its confidence.
    rule : the decision rule, in words.
    data_sha256 : digest of every measurement of the lot.
    limits, not_proposed : measurements with and without a proposal, in the order of the recipe's measurements.
    lot_fails_any : sensors of the lot that fail at least one of the limits.
    without_size : overlaps that a recipe accepts only if it also bounds the blob's size, which these limits do not.
    output : the written file, or None.
    """

    version: str
    date: date
    coverage: float
    confidence: float
    guard_factor: float
    rule: str
    data_sha256: str
    lot: Lot
    limits: tuple[ProposedLimit, ...]
    not_proposed: tuple[NoLimit, ...]
    lot_fails_any: tuple[str, ...]
    without_size: tuple[str, ...]
    output: str | None


def propose_limits(
    choice: LotChoice,
    terms: Terms,
    *,
    names: tuple[str, ...] = (),
    everything: bool = False,
    version: str | None = None,
    output: Path | None = None,
    database: str | None = None,
    made: date,
) -> ProposedLimits:
    """Propose limits from a golden lot, and write them to a file if requested.

    Parameters
    ----------
    names, everything : measurements; by default those limited by the recipe (all if it has no limits).
    version : version of the limits; by default the day and the first digits of the data's digest.
    output : file to write, which must not exist yet.

    Raises
    ------
    RefusedError
        If the lot or the terms cannot be used, or nothing can be proposed for a named measurement, or for any;
        nothing is written then.
    """
    if version is not None and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", version):
        raise RefusedError(
            f"version {echo(version, 64)} cannot be used", remedy="1 to 64 letters, digits and . _ -, no sign first"
        )
    if output is not None:
        refuse_existing(output)
    with open_store(database_url(database), create=False) as store:
        lot = gather(store, choice)
    digest = lot.data_sha256()
    proposals = tuple(propose(group, lot, terms) for group in groups_of(lot, names, everything))
    _check_any(proposals, names)
    limits = tuple(proposal for proposal in proposals if isinstance(proposal, ProposedLimit))
    proposed = fill_from_object(
        ProposedLimits,
        terms,
        version=version or f"{made.isoformat()}-{digest[:8]}",
        date=made,
        rule=RULE.format(factor=terms.guard_factor),
        data_sha256=digest,
        lot=lot,
        limits=limits,
        not_proposed=tuple(proposal for proposal in proposals if isinstance(proposal, NoLimit)),
        lot_fails_any=tuple(sorted({serial for limit in limits for serial in limit.lot_fails})),
        without_size=_name_unsized(limits),
        output=None if output is None else str(output),
    )
    if output is not None:
        write_new(output, limits_toml(proposed))
    return proposed


def _check_any(proposals: tuple[ProposedLimit | NoLimit, ...], names: tuple[str, ...]) -> None:
    """Refuse if there is no limit for a named measurement, or for any."""
    for name in names or (None,):
        members = [proposal for proposal in proposals if name in (None, proposal.measurement)]
        refusals = [member for member in members if isinstance(member, NoLimit)]
        if len(refusals) == len(members):
            reasons = "\n".join(
                f"  {refusal.label}: {refusal.why}{list_far_from_others(refusal)}" for refusal in refusals[:10]
            )
            more_reasons = f"\n  and {len(members) - 10} more" if len(members) > 10 else ""
            raise RefusedError(
                f"no limit can be proposed from this lot:\n{reasons}{more_reasons}",
                remedy="test more sensors, leave out what does not belong by --without, or ask for less --coverage",
            )


def list_far_from_others(refusal: NoLimit) -> str:
    """List sensors far from the others, in brackets after a space; empty without any."""
    return f" ({', '.join(refusal.far_out)} far from the others)" if refusal.far_out else ""


def _name_unsized(limits: tuple[ProposedLimit, ...]) -> tuple[str, ...]:
    sized = {
        (limit.phase, limit.qualifier)
        for limit in limits
        if limit.measurement == "area_ratio" and (limit.lower or 0.0) > 0 and limit.upper is not None
    }
    overlaps = [limit for limit in limits if limit.measurement == "area_overlap"]
    return tuple(overlap.label for overlap in overlaps if (overlap.phase, overlap.qualifier) not in sized)


def lot_words(lot: Lot) -> str:
    """Return the lot in one line."""
    counts = f"{plural(len(lot.sensors), 'sensor')}, {plural(len(lot.runs), 'run')}"
    description = f"{lot.chosen}: {counts} at {', '.join(lot.stations)}"
    return f"{description} (SIMULATED)" if lot.simulated else description


def limits_toml(proposed: ProposedLimits) -> str:
    """Return the file for a recipe, its limits sealed by their digest."""
    tables = [_limit_table(limit.limit(proposed.version)) for limit in proposed.limits]
    header = {
        "version": proposed.version,
        "date": proposed.date.isoformat(),
        "lot": lot_words(proposed.lot),
        "serials": list(proposed.lot.sensors),
        "coverage_percent": round(100 * proposed.coverage, 9),
        "confidence_percent": round(100 * proposed.confidence, 9),
        "rule": proposed.rule,
        "data_sha256": proposed.data_sha256,
        "limits_sha256": limits_digest(tables),
    }
    return toml_document({"limits_version": header, "limits": tables}, tuple(_remarks(proposed)))


def _remarks(proposed: ProposedLimits) -> Iterator[str]:
    lot = proposed.lot
    yield 'Limits proposed by cbsr-qa limits propose; limits_from = "this file" in [recipe] takes them in.'
    if lot.simulated:
        yield f"From SIMULATED sensors: {'; '.join(lot.simulated)}"
    if lot.left_out:
        yield f"Left out on request: {', '.join(lot.left_out)}"
    yield from (f"Taken in although not good: {remark}" for remark in lot.not_good)
    yield from (f"Mixed {remark}" for remark in lot.mixed)
    yield from (SIZELESS.format(label=label) for label in proposed.without_size)
    yield from (f"No limit for {refusal.label}: {refusal.why}" for refusal in proposed.not_proposed)


def _limit_table(limit: Limit) -> dict[str, Any]:
    table = {
        "measurement": limit.measurement,
        "unit": limit.unit,
        "lower": limit.lower,
        "upper": limit.upper,
        "marginal": limit.marginal or None,
        "phase": limit.phase or None,
        "qualifier": limit.qualifier or None,
        "version": limit.version or None,
    }
    return {key: value for key, value in table.items() if value is not None}


def write_new(path: Path, text: str) -> None:
    """Write a new file, whole or not at all; RefusedError if it exists, or its folder cannot be written to."""
    refuse_existing(path)
    with writing(path), write_atomically(path) as file:
        file.write(text.encode())


def refuse_existing(path: Path) -> None:
    """Refuse to overwrite a file: limits used to judge runs must not change."""
    with writing(path):
        exists = path.exists()
    if path.suffix != ".toml":
        raise RefusedError(f"{path} is not named as a TOML file", remedy=f"name it {path.stem}.toml, for example")
    if exists:
        raise RefusedError(f"{path} exists already", remedy="name another file: versions of limits are kept")
