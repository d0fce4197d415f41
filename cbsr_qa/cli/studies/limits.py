"""``cbsr-qa limits``: limits and guard bands from a golden lot.

The words of ``cbsr-qa limits propose``: a table, with what each number rests on below it.
"""

import textwrap
from collections.abc import Iterator
from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cbsr_qa.cli.output import emit_json, note, say
from cbsr_qa.config import printable

if TYPE_CHECKING:
    from cbsr_qa.domain.results import Limit
    from cbsr_qa.stats import Bound, LotLimits, Risks
    from cbsr_qa.studies.limits import Proposal, ProposedLimits


app = typer.Typer(help="Propose limits from sensors known to be good.", no_args_is_help=True)

_DAY = ["%Y-%m-%d"]


@app.callback()
def _group() -> None:
    """Propose limits from sensors known to be good."""


@app.command("propose")
def propose(
    serial: Annotated[list[str] | None, typer.Option(help="A sensor of the golden lot; may be repeated.")] = None,
    serials: Annotated[Path | None, typer.Option(help="File with one serial number a line.")] = None,
    batch: Annotated[str | None, typer.Option(help="Runs of this batch.")] = None,
    recipe: Annotated[str | None, typer.Option(help="Runs of the recipe of this name.")] = None,
    since: Annotated[datetime | None, typer.Option(formats=_DAY, help="Runs from this day on (UTC).")] = None,
    until: Annotated[datetime | None, typer.Option(formats=_DAY, help="Runs to the end of this day (UTC).")] = None,
    without: Annotated[list[str] | None, typer.Option(help="Leave this sensor out; may be repeated.")] = None,
    measurement: Annotated[
        list[str] | None, typer.Option(help="What to limit; may be repeated. By default what the recipe limits now.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Limit everything that was measured.")] = False,
    coverage: Annotated[float, typer.Option(help="Per cent of good sensors that each limit holds.")] = 99.0,
    confidence: Annotated[float, typer.Option(help="How sure that is to be, in per cent.")] = 95.0,
    guard_factor: Annotated[float, typer.Option(help="Guard band over expanded uncertainty.")] = 1.0,
    distribution: Annotated[
        str, typer.Option(help="Of single values: normal, log-normal, any, or auto (the widest not refuted).")
    ] = "auto",
    include_failed: Annotated[bool, typer.Option("--include-failed", help="Take runs in that failed.")] = False,
    allow_mixed: Annotated[
        bool, typer.Option("--allow-mixed", help="Take runs of mixed recipes or software.")
    ] = False,
    name: Annotated[str | None, typer.Option("--limits-version", help="Name of this version of limits.")] = None,
    output: Annotated[Path | None, typer.Option(help="TOML file to write; must not exist yet.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; by default SQLite in var/.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")] = False,
) -> None:
    """Propose limits and guard bands from stored runs of sensors known to be good, a golden lot."""
    from cbsr_qa.studies.limits import LotChoice, Terms, propose_limits, read_serials
    from cbsr_qa.system import RealClock

    named = (*(serial or ()), *(read_serials(serials) if serials else ()))
    choice = LotChoice(
        serials=tuple(dict.fromkeys(named)),
        batch=batch,
        recipe=recipe,
        since=_day(since),
        until=_day(until),
        without=tuple(without or ()),
        include_failed=include_failed,
        allow_mixed=allow_mixed,
    )
    found = propose_limits(
        choice,
        Terms.of_words(coverage, confidence, guard_factor, distribution),
        names=tuple(measurement or ()),
        everything=everything,
        version=name,
        output=output,
        database=database,
        made=RealClock().wall().date(),
    )
    if as_json:
        emit_json(found.document())
    else:
        for line in lines(found):
            say(line)
    if output is not None:
        note(f"{output}: {len(found.proposed)} limits, version {found.version}")


def _day(moment: datetime | None) -> date | None:
    return None if moment is None else moment.date()


WIDTH = 100
_LEAST_SHARE = 1e-6  #: smaller risks say nothing: no distribution is known that far out
_COLUMNS = "  {:<7}{:>10}{:>10}  {:<11}{:>10}{:>10}{:>10}  {:<13}{}"


def lines(found: "ProposedLimits") -> Iterator[str]:
    """Lay out what a golden lot says, one line after another."""
    yield from _wrapped("golden lot  ", printable(found.lot_words()))
    yield from _wrapped("version     ", f"{found.version}, data SHA-256 {found.data_sha256[:16]}…")
    yield from _wrapped("each limit  ", _promise(found))
    yield from _wrapped("rule        ", found.rule)
    yield from _remarks(found)
    yield ""
    yield _COLUMNS.format(
        "sensors", "mean", "spread", "taken for", "lower", "upper", "guard", "present", "fails"
    ).rstrip()
    for proposal in found.proposed:
        yield from _proposal(proposal, found.terms.guard_factor)
    if found.refused:
        yield ""
        yield "no limit is proposed for"
    for proposal in found.refused:
        far = f" ({', '.join(proposal.far_out)} far from the others)" if proposal.far_out else ""
        yield from _wrapped("  ", printable(f"{proposal.group.label}: {proposal.found.why}{far}"))


def _promise(found: "ProposedLimits") -> str:
    """Say what the limits hold, each by itself and together."""
    terms, count = found.terms, len(found.proposed)
    share = f"holds {100 * terms.coverage:g} % of good sensors, with {100 * terms.confidence:g} % confidence"
    together = min(100 * count * (1 - terms.coverage), 100.0)
    all_of_them = f"; one of all {count} may fail up to {together:.3g} %" if count > 1 else ""
    names = f": {', '.join(found.failing[:6])}{' …' if len(found.failing) > 6 else ''}" if found.failing else ""
    return f"{share}{all_of_them}; of this lot {len(found.failing)} of {len(found.lot.sensors)} sensors fail{names}"


def _remarks(found: "ProposedLimits") -> Iterator[str]:
    from cbsr_qa.studies.limits import SIZELESS

    lot = found.lot
    if lot.left_out:
        yield from _wrapped("left out    ", ", ".join(lot.left_out))
    for words in lot.not_good:
        yield from _wrapped("not good    ", printable(words))
    for words in lot.mixed:
        yield from _wrapped("mixed       ", printable(words))
    for label in found.sizeless:
        yield from _wrapped("no size     ", f"{printable(label)}: {SIZELESS}")


def _proposal(proposal: "Proposal", guard_factor: float) -> Iterator[str]:
    group, limit = proposal.group, proposal.limit
    assert limit is not None
    bounds = proposal.bounds
    widest = max(bounds, key=lambda bound: bound.deviation)
    count = len(group.sensors)
    yield printable(f"{group.label}, {group.unit}" if group.unit != "1" else group.label)
    yield _COLUMNS.format(
        f"{count} × {group.values}" if group.values > 1 else count,
        _number(proposal.mean),
        _number(widest.deviation),
        _taken_for(bounds),
        _rounded_already(limit.lower),
        _rounded_already(limit.upper),
        _number(limit.marginal) if limit.marginal else "none",
        _limit_words(group.present),
        _fails(proposal, count),
    ).rstrip()
    for bound in bounds:
        yield from _wrapped("    ", _bound_words(bound, group.values))
    yield from _wrapped("    ", _guard_words(proposal, guard_factor))
    if proposal.risks is not None:
        accepted, refused = proposal.risks
        words = f"marginal accepted: {_risk_words(accepted)}; marginal refused: {_risk_words(refused)}"
        yield from _wrapped("    ", f"risks, {words}")
    elif proposal.uncertainty is not None:
        yield f"    no risks: {proposal.no_risks}"
    if limit.lower is not None and limit.lower <= 0 and proposal.always_positive:
        yield from _wrapped(
            "    ", "the lower limit is not above 0, as all values are: it fails nothing that cannot be negative"
        )
    if group.present is None:
        yield "    limited on both sides, because the recipe sets no limit"
    if proposal.far_out:
        without = _bare(proposal.without_far_out)
        yield from _wrapped(
            "    ", f"far from the others, and in the lot: {', '.join(proposal.far_out)}; without: {without}"
        )


def _taken_for(bounds: "tuple[Bound, ...]") -> str:
    names = dict.fromkeys(str(bound.distribution).partition(" ")[0] for bound in bounds)
    return next(iter(names)) if len(names) == 1 else "see below"


def _bound_words(bound: "Bound", values: int) -> str:
    """Say what a bound rests on: ``upper: largest of the 9 values of a run, each normal (p = 0.4), k = 3.6 …``."""
    side, worst = ("upper", "largest") if bound.scale.sign > 0 else ("lower", "smallest")
    what = f"{worst} of the {values} values of a run" if values > 1 else "one value a run"
    best: dict[str, float] = {}
    for name, fit in bound.fits:
        best[str(name)] = max(fit.p_value, best.get(str(name), 0.0))
    possible = {str(name) for name, fit in bound.fits if not fit.refuted}
    refuted = ", ".join(f"{name} (p = {p_value:.2g})" for name, p_value in best.items() if name not in possible)
    if bound.factor is None:
        return f"{side}: {what}, by their order alone{f'; refuted: {refuted}' if refuted else ''}"
    each = "" if values == 1 else "each " if bound.independent == values else "itself "
    logs = " of logarithms" if bound.scale.logarithmic else ""
    words = f"{side}: {what}, {each}{bound.distribution} (p = {best[str(bound.distribution)]:.2g})"
    words += f", k = {bound.factor:.3f}{logs}; mean {_number(bound.mean)}, deviation {_number(bound.deviation)}"
    others = ", ".join(f"{name} would give {_number(limit)}" for name, limit in bound.narrower)
    words += f"; not refuted either: {others}" if others else ""
    return f"{words}; refuted: {refuted}" if refuted else words


def _guard_words(proposal: "Proposal", guard_factor: float) -> str:
    found = proposal.uncertainty
    if found is None:
        return f"no guard band: {proposal.no_guard}"
    unit = "" if proposal.group.unit == "1" else f" {proposal.group.unit}"
    freedom = "" if found.freedom is None else f", {found.freedom} degrees of freedom"
    factors = f"{guard_factor:g} × {found.coverage_factor:.2f} × {_number(found.standard)}{unit}"
    marginal = f"; {len(proposal.marginal)} of the lot would pass marginally" if proposal.marginal else ""
    return f"guard band {factors} ({found.source}{freedom}){marginal}"


def _risk_words(risks: "Risks") -> str:
    return f"consumer's {_share(risks.consumer)}, producer's {_share(risks.producer)}"


def _share(share: float) -> str:
    return f"{100 * share:.2g} %" if share >= _LEAST_SHARE else f"below {100 * _LEAST_SHARE:g} %"


def _limit_words(limit: "Limit | None") -> str:
    if limit is None:
        return "none"
    if limit.lower is not None and limit.upper is not None:
        return f"{_number(limit.lower)} to {_number(limit.upper)}"
    return f"≥ {_number(limit.lower)}" if limit.lower is not None else f"≤ {_number(limit.upper)}"


def _fails(proposal: "Proposal", count: int) -> str:
    now = "–" if proposal.group.present is None else str(len(proposal.failed_now))
    return f"{now} → {len(proposal.failed)} of {count}"


def _bare(found: "LotLimits | None") -> str:
    if found is None or found.why:
        return "none" if found is None else found.why
    lower, upper = (None if bound is None else bound.limit for bound in (found.lower, found.upper))
    return " ".join(f"{sign} {_number(b)}" for sign, b in (("≥", lower), ("≤", upper)) if b is not None)


def _rounded_already(value: float | None) -> str:
    return "–" if value is None else f"{value:.9g}"


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return "–"
    text = f"{value:.{digits}g}"
    return text if len(text) < 10 else f"{value:.3g}"


def _wrapped(start: str, text: str) -> Iterator[str]:
    indent = " " * len(start) if start.strip() else f"{start}  "
    yield from textwrap.wrap(
        text, WIDTH, initial_indent=start, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
