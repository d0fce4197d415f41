"""Limits and guard bands from a golden lot: read from the store, proposed, written to a file of their own."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, Final

from cbsr_qa.config import database_url, echo
from cbsr_qa.domain import RefusedError
from cbsr_qa.domain.results import Limit
from cbsr_qa.report import plural
from cbsr_qa.stats import Bound, LotLimits, Risks
from cbsr_qa.store import open_store
from cbsr_qa.studies.limits.golden_lot import Lot, LotChoice, gather
from cbsr_qa.studies.limits.groups import groups_of
from cbsr_qa.studies.limits.proposals import (
    RULE,
    Proposal,
    Terms,
    limit_table,
    limits_toml,
    propose,
    refuse_existing,
    write_new,
)

#: Why a recipe may refuse a limit of the overlap.
SIZELESS: Final = "a recipe takes this in only with area_ratio limited there too, above 0 and on both sides"


@dataclass(frozen=True, slots=True)
class ProposedLimits:
    """What a golden lot says.

    Parameters
    ----------
    version : name of these limits.
    made : the day.
    data_sha256 : of every measurement of the lot.
    proposals : in the order of the recipe's measurements; those without a limit say why.
    output : the file that was written; None where none was asked for.
    """

    version: str
    made: date
    lot: Lot
    terms: Terms
    data_sha256: str
    proposals: tuple[Proposal, ...]
    output: Path | None = None

    @property
    def proposed(self) -> tuple[Proposal, ...]:
        """Those that came to a limit."""
        return tuple(proposal for proposal in self.proposals if proposal.limit is not None)

    @property
    def refused(self) -> tuple[Proposal, ...]:
        """Those that did not."""
        return tuple(proposal for proposal in self.proposals if proposal.limit is None)

    @property
    def failing(self) -> tuple[str, ...]:
        """Sensors of the lot that fail at least one of the proposed limits."""
        return tuple(sorted({serial for proposal in self.proposed for serial in proposal.failed}))

    @property
    def sizeless(self) -> tuple[str, ...]:
        """Overlaps that a recipe takes in only if it bounds the blob's size itself: these limits do not."""
        sized = {
            (limit.phase, limit.qualifier)
            for limit in self._limits()
            if limit.measurement == "area_ratio" and (limit.lower or 0.0) > 0 and limit.upper is not None
        }
        overlaps = [p.group for p in self.proposed if p.group.name == "area_overlap"]
        return tuple(group.label for group in overlaps if (group.phase, group.qualifier) not in sized)

    @property
    def rule(self) -> str:
        """The decision rule, in words."""
        return f"{RULE}; guard band = {self.terms.guard_factor:g} × expanded uncertainty"

    def lot_words(self) -> str:
        """The lot in one line."""
        counts = f"{plural(len(self.lot.sensors), 'sensor')}, {plural(len(self.lot.runs), 'run')}"
        words = f"{self.lot.words}: {counts} at {', '.join(self.lot.stations())}"
        return f"{words} (SIMULATED)" if self.lot.simulated else words

    def document(self) -> dict[str, Any]:
        """Return everything for ``--json``."""
        return {
            "version": self.version,
            "date": self.made.isoformat(),
            "coverage": self.terms.coverage,
            "confidence": self.terms.confidence,
            "guard_factor": self.terms.guard_factor,
            "rule": self.rule,
            "data_sha256": self.data_sha256,
            "lot": _lot_document(self.lot),
            "limits": [_proposal_document(proposal) for proposal in self.proposed],
            "not_proposed": [{**_identity(p), "why": p.found.why, "far_out": list(p.far_out)} for p in self.refused],
            "lot_fails_any": list(self.failing),
            "without_size": list(self.sizeless),
            "output": None if self.output is None else str(self.output),
        }

    def toml(self) -> str:
        """Return the file a recipe takes in."""
        header = {
            "version": self.version,
            "date": self.made.isoformat(),
            "lot": self.lot_words(),
            "serials": list(self.lot.sensors),
            "coverage_percent": round(100 * self.terms.coverage, 9),
            "confidence_percent": round(100 * self.terms.confidence, 9),
            "rule": self.rule,
            "data_sha256": self.data_sha256,
        }
        return limits_toml(header, self._limits(), self._remarks())

    def _limits(self) -> list[Limit]:
        return [proposal.limit for proposal in self.proposals if proposal.limit is not None]

    def _remarks(self) -> Iterator[str]:
        yield 'Limits proposed by cbsr-qa limits propose; limits_from = "this file" in [recipe] takes them in.'
        if self.lot.simulated:
            yield f"From SIMULATED sensors: {'; '.join(self.lot.simulated)}"
        if self.lot.left_out:
            yield f"Left out by name: {', '.join(self.lot.left_out)}"
        yield from (f"Taken in although not good: {words}" for words in self.lot.not_good)
        yield from (f"Mixed {words}" for words in self.lot.mixed)
        yield from (f"{label}: {SIZELESS}" for label in self.sizeless)
        for proposal in self.refused:
            yield f"No limit for {proposal.group.label}: {proposal.found.why}"


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
    """Propose limits from a golden lot, and write them to a file where one is asked for.

    Parameters
    ----------
    choice, terms : which runs, and what is asked of the limits.
    names : measurements; none for those the recipe limits now (all where it limits none).
    everything : all measurements.
    version : name of the version; by default the day and the first digits of the data's digest.
    output : must not exist yet.
    database : URL or path; None for ``CBSR_QA_DATABASE`` or the default.
    made : the day.

    Raises
    ------
    RefusedError
        If the lot or what is asked of it cannot be used, or nothing can be proposed for a measurement that was
        named, or for any; nothing is written then.
    """
    if version is not None and not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", version):
        raise RefusedError(
            f"version {echo(version, 64)} cannot be used", remedy="1 to 64 letters, digits and . _ -, no sign first"
        )
    if output is not None:
        refuse_existing(output)
    with open_store(database_url(database), create=False) as store:
        lot = gather(store, choice)
    groups = groups_of(lot, names, everything)
    digest = lot.data_sha256()
    version = version or f"{made.isoformat()}-{digest[:8]}"
    proposals = tuple(propose(group, lot, terms, version) for group in groups)
    _check_any(proposals, names)
    found = ProposedLimits(version, made, lot, terms, digest, proposals, output)
    if output is not None:
        write_new(output, found.toml())
    return found


def _check_any(proposals: tuple[Proposal, ...], names: tuple[str, ...]) -> None:
    """Refuse where a measurement that was named came to nothing, or all did."""
    for name in names or (None,):
        members = [p for p in proposals if name in (None, p.group.name)]
        if not any(p.limit is not None for p in members):
            said = "\n".join(f"  {p.group.label}: {p.found.why}{_seen_far_out(p)}" for p in members[:10])
            rest = f"\n  and {len(members) - 10} more" if len(members) > 10 else ""
            raise RefusedError(
                f"no limit can be proposed from this lot:\n{said}{rest}",
                remedy="test more sensors, leave out what does not belong by --without, or ask for less --coverage",
            )


def _seen_far_out(proposal: Proposal) -> str:
    return f" ({', '.join(proposal.far_out)} far from the others)" if proposal.far_out else ""


def _lot_document(lot: Lot) -> dict[str, Any]:
    return {
        "chosen": lot.words,
        "sensors": {serial: [run.summary.run for run in runs] for serial, runs in lot.sensors.items()},
        "stations": list(lot.stations()),
        "software": [list(pair) for pair in lot.runs[0].analysis.software],
        "left_out": list(lot.left_out),
        "not_good": list(lot.not_good),
        "mixed": list(lot.mixed),
        "simulated": list(lot.simulated),
    }


def _identity(proposal: Proposal) -> dict[str, Any]:
    group = proposal.group
    return {"measurement": group.name, "unit": group.unit, "phase": group.phase, "qualifier": group.qualifier}


def _proposal_document(proposal: Proposal) -> dict[str, Any]:
    assert proposal.limit is not None
    group, limit, present = proposal.group, proposal.limit, proposal.group.present
    return {
        **_identity(proposal),
        "values": group.values,
        "sides": "both, because the recipe sets no limit" if present is None else "those of the present limit",
        "mean": proposal.mean,
        "lower": limit.lower,
        "upper": limit.upper,
        "marginal": limit.marginal,
        "bounds": {side: _bound_document(b) for side, b in _sides(proposal.found) if b is not None},
        "uncertainty": _uncertainty_document(proposal),
        "risks": _risks_document(proposal.risks),
        "no_risks": proposal.no_risks,
        "far_out": list(proposal.far_out),
        "without_far_out": _bare(proposal.without_far_out),
        "present": None if present is None else limit_table(_unversioned(present)),
        "lot_fails_present": None if present is None else list(proposal.failed_now),
        "lot_fails": list(proposal.failed),
        "lot_marginal": list(proposal.marginal),
    }


def _unversioned(limit: Limit) -> Limit:
    return Limit(
        limit.measurement, limit.unit, limit.lower, limit.upper, limit.marginal, limit.phase, limit.qualifier
    )


def _sides(found: LotLimits) -> tuple[tuple[str, Bound | None], ...]:
    return ("lower", found.lower), ("upper", found.upper)


def _bound_document(bound: Bound) -> dict[str, Any]:
    return {
        "limit": bound.limit,
        "distribution": str(bound.distribution),
        "independent_values": bound.independent,
        "tests": [{"distribution": str(name), "p_value": fit.p_value} for name, fit in bound.fits],
        "factor": bound.factor,
        "worst_mean": bound.mean,
        "worst_deviation": bound.deviation,
        "narrower": [{"distribution": str(name), "limit": limit} for name, limit in bound.narrower],
    }


def _uncertainty_document(proposal: Proposal) -> dict[str, Any]:
    found = proposal.uncertainty
    if found is None:
        return {"standard": None, "expanded": None, "degrees_of_freedom": None, "source": proposal.no_guard}
    return {
        "standard": found.standard,
        "expanded": found.expanded,
        "degrees_of_freedom": found.freedom,
        "source": found.source,
    }


def _risks_document(found: tuple[Risks, Risks] | None) -> dict[str, Any] | None:
    if found is None:
        return None
    accepted, refused = found
    return {
        "marginal_accepted": {"consumer": accepted.consumer, "producer": accepted.producer},
        "marginal_refused": {"consumer": refused.consumer, "producer": refused.producer},
    }


def _bare(found: LotLimits | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {**{side: bound and bound.limit for side, bound in _sides(found)}, "why": found.why}
