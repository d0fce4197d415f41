"""Report of proposed limits: a table of limits, the basis of each, guard bands and risks."""

from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.report import Banner, Block, CommandOutcome, Page, Paragraph, Section, Table
from cbsr_qa.report.tables import list_names, number, plural, text_table, unit_shown
from cbsr_qa.stats.averaged_bound import CONTAMINATED, HEAVIEST
from cbsr_qa.stats.golden_lots import Bound
from cbsr_qa.stats.guard_bands import Risks
from cbsr_qa.stats.intervals import count_needed
from cbsr_qa.stats.lot_shapes import Distribution
from cbsr_qa.studies.limits.promise import (
    KEPT_PERCENT,
    LOT_SIZES,
    MEASURED_FOR,
    exceeds_share,
    warn_of_few_sensors,
)
from cbsr_qa.studies.limits.proposals import ProposedLimit
from cbsr_qa.studies.limits.propose import SIZELESS, ProposedLimits, list_far_from_others, lot_words

_NONE: Final = "–"
_LEAST_SHARE: Final = 1e-6  #: smaller risks are meaningless: no distribution is known that far out
_LEAST_NAMED: Final = 0.05  #: share of a family that is named
_LIKELY: Final = 0.5  #: share from which the lot is said to be of some families

# Sentences, in reading order.
_ACCEPT: Final = "{limits} to accept"
_LOOK: Final = "{limits} to check before you accept"
_EACH: Final = (
    "{fails}; each holds {coverage:g} % of good sensors, with {confidence:g} % confidence, if the condition in the"
    " notes holds{together}"
)
_TOGETHER: Final = "; the {count} together may fail up to {percent:.3g} %"
_LOT_FAILS: Final = "{failing} of {sensors} sensors of the lot fail{names}"
_LIMITS: Final = (
    "Present limit, proposed one with guard band; sensors of the lot that fail the present limit → the proposed one,"
    " and that pass it marginally."
)
_BASIS: Final = (
    "Basis of each limit: the worst value of each run, its distribution or shares of families, the factor k on the "
    "deviation, and the limits from single distributions that are not refuted."
)
_GUARD: Final = (
    "Guard band = {factor:g} × k × standard uncertainty u of one run; consumer's and producer's risk (C, P) if "
    "marginal passes are accepted, and if they are refused."
)
_CONDITION: Final = "The promise of {labels} holds {condition}."
_HEAVY_LOT: Final = (
    "{label}: the lot itself looks heavier-tailed than its condition ({families}): the promise may not hold; find out"
    " why some sensors are far from the others, or give --distribution heavy."
)
_NO_CONDITION: Final = "No condition is needed from {one} sensors on for one bound, from {two} for two."
_KEPT: Final = (
    "Simulated lots that keep the promise of {coverage:g} % with {confidence:g} % confidence, in %, by the number of"
    " sensors and what they are like; --distribution heavy keeps it for Student's t with 3 degrees of freedom."
)
_NO_GUARD: Final = "{label}: no guard band: {why}."
_NO_RISKS: Final = "{label}: no risks: {why}."
_NEGATIVE: Final = (
    "{label}: the lower limit is not above 0, although all values are: no value can fail it if the quantity is never"
    " negative. Then --distribution log-normal gives one above 0."
)
_ABOVE_SHARE: Final = "{label}: the upper limit is not below 100 %, which no value exceeds: no value can fail it."
_BOTH: Final = "{label}: limited on both sides, because the recipe sets no limit."
_FAR: Final = "{label}: {serials} far from the others, but part of the lot; limit without: {limits}."
_NOT_PROPOSED: Final = "{label}: no limit is proposed: {why}{far}."


def limits_outcome(proposed: ProposedLimits) -> CommandOutcome[ProposedLimits]:
    """Lay proposed limits out."""
    guarded = [limit for limit in proposed.limits if limit.uncertainty.standard is not None]
    basis: list[Block] = [_basis(proposed.limits)]
    basis += [_guards(guarded, proposed.guard_factor)] if guarded else []
    sections = [Section("Limits", (_limits(proposed),)), Section("Basis", tuple(basis))]
    notes = tuple(_notes(proposed))
    sections += [Section("Notes", notes)] if notes else []
    return CommandOutcome(proposed, _page(proposed), tuple(sections))


def _page(proposed: ProposedLimits) -> Page:
    lot, count, failing = proposed.lot, len(proposed.limits), proposed.lot_fails_any
    joint_percent = min(100 * count * (1 - proposed.coverage), 100.0)
    fails = _LOT_FAILS.format(
        failing=len(failing), sensors=len(lot.sensors), names=f": {list_names(failing)}" if failing else ""
    )
    reason = _EACH.format(
        coverage=100 * proposed.coverage,
        confidence=100 * proposed.confidence,
        together=_TOGETHER.format(count=count, percent=joint_percent) if count > 1 else "",
        fails=fails,
    )
    facts = [
        ("Golden lot", lot_words(lot)),
        ("Version", f"{proposed.version}, data SHA-256 {proposed.data_sha256[:16]}…"),
    ]
    facts += [("Rule", proposed.rule)]
    facts += [("Left out", ", ".join(lot.left_out))] if lot.left_out else []
    facts += [("File", proposed.output)] if proposed.output else []
    warnings = (*(f"not good: {words}" for words in lot.not_good), *(f"mixed {words}" for words in lot.mixed))
    warnings += tuple(SIZELESS.format(label=label) for label in proposed.without_size)
    headline = (_LOOK if failing or warnings else _ACCEPT).format(limits=plural(count, "limit"))
    banner = Banner("plain", _NONE, headline, reason)
    return Page("Proposed limits", proposed.version, banner, tuple(facts), lot.simulated, warnings)


def _limits(proposed: ProposedLimits) -> Table:
    columns = ("measurement", "unit", "present", "lower", "upper", "guard", "sensors", "fail", "marginal")
    rows = []
    for limit in proposed.limits:
        present_failures = _NONE if limit.lot_fails_present is None else len(limit.lot_fails_present)
        rows.append(
            (
                limit.label,
                unit_shown(limit.unit),
                _limit_words(limit.present),
                _exact(limit.lower),
                _exact(limit.upper),
                number(limit.marginal) if limit.marginal else "none",
                f"{limit.sensors} × {limit.values}" if limit.values > 1 else str(limit.sensors),
                f"{present_failures} → {len(limit.lot_fails)} of {limit.sensors}",
                str(len(limit.lot_marginal)),
            )
        )
    return text_table(_LIMITS, columns, rows, (3, 4, 5, 6, 8))


def _basis(limits: tuple[ProposedLimit, ...]) -> Table:
    columns = ("measurement", "side", "value of a run", "distribution", "p", "k", "mean", "deviation", "others")
    rows = [
        (limit.label, side, *_describe_basis(bound, limit.values))
        for limit in limits
        for side, bound in limit.bounds.items()
    ]
    return text_table(_BASIS, (*columns, "refuted (p)"), rows, (4, 5, 6, 7))


def _describe_basis(bound: Bound, values: int) -> tuple[str, ...]:
    worst = "largest" if bound.scale.sign > 0 else "smallest"
    best: dict[str, float] = {}
    for fit in bound.tests:
        best[fit.distribution] = max(fit.p_value, best.get(fit.distribution, 0.0))
    possible = {fit.distribution for fit in bound.tests if not fit.refuted}
    refuted_names = [f"{name} ({p_value:.2g})" for name, p_value in best.items() if name not in possible]
    itself = "" if values in (1, bound.independent_values) else ", itself"
    logs = " of log" if bound.scale.logarithmic else ""
    return (
        f"{worst} of {values}{itself}" if values > 1 else "single",
        _families(bound),
        _NONE if bound.distribution not in best else f"{best[bound.distribution]:.2g}",
        _NONE if bound.factor is None else f"{bound.factor:.3f}{logs}",
        number(bound.worst_mean, 4),
        number(bound.worst_deviation, 4),
        ", ".join(f"{other.distribution} {number(other.limit, 4)}" for other in bound.narrower) or _NONE,
        ", ".join(refuted_names) or _NONE,
    )


def _families(bound: Bound) -> str:
    if bound.distribution is not Distribution.SEVERAL:
        return str(bound.distribution)
    named = [family for family in bound.families if family.share >= _LEAST_NAMED]
    return ", ".join(f"{family.family} {100 * family.share:.0f} %" for family in named)


def _looks_heavy(bound: Bound) -> bool:
    """Whether families with heavier tails than the condition explain the lot better than all others together."""
    heavy_share = sum(family.share for family in bound.families if family.family in (HEAVIEST, CONTAMINATED))
    return bound.distribution is Distribution.SEVERAL and heavy_share > _LIKELY


def _warn_of_heavy_lots(limits: tuple[ProposedLimit, ...]) -> Iterator[Paragraph]:
    for limit in limits:
        for families in dict.fromkeys(_families(bound) for bound in limit.bounds.values() if _looks_heavy(bound)):
            yield Paragraph(_HEAVY_LOT.format(label=limit.label, families=families), "warning")


def _guards(guarded: list[ProposedLimit], factor: float) -> Table:
    risks = ("C accepted", "P accepted", "C refused", "P refused")
    rows = []
    for limit in guarded:
        uncertainty, risk_cells = limit.uncertainty, [_NONE] * 4
        assert uncertainty.standard is not None
        assert uncertainty.coverage_factor is not None
        if limit.risks is not None:
            risk_cells = [*_shares(limit.risks.marginal_accepted), *_shares(limit.risks.marginal_refused)]
        freedom = _NONE if uncertainty.degrees_of_freedom is None else str(uncertainty.degrees_of_freedom)
        uncertainty_cells = (
            f"{uncertainty.coverage_factor:.2f}",
            number(uncertainty.standard, 4),
            unit_shown(limit.unit),
            uncertainty.source,
            freedom,
        )
        rows.append((limit.label, *uncertainty_cells, *risk_cells))
    columns = ("measurement", "k", "u", "unit", "source", "degrees of freedom", *risks)
    return text_table(_GUARD.format(factor=factor), columns, rows, (1, 2, 5, 6, 7, 8, 9))


def _notes(proposed: ProposedLimits) -> Iterator[Block]:
    yield from _describe_promise(proposed)
    yield from _warn_of_heavy_lots(proposed.limits)
    for limit in proposed.limits:
        yield from _describe_limit(limit)
    for none in proposed.not_proposed:
        text = _NOT_PROPOSED.format(label=none.label, why=none.why, far=list_far_from_others(none))
        yield Paragraph(text, "warning")


def _describe_promise(proposed: ProposedLimits) -> Iterator[Block]:
    """Yield the condition of the promise, and what is known of lots that keep it."""
    labels: dict[str, list[str]] = {}
    for limit in proposed.limits:
        labels.setdefault(limit.condition, []).append(limit.label)
    for condition, members in labels.items():
        yield Paragraph(_CONDITION.format(labels=list_names(members), condition=condition), "note")
    if any(bound.families for limit in proposed.limits for bound in limit.bounds.values()):
        one, two = (count_needed(proposed.coverage, proposed.confidence, sides) for sides in (1, 2))
        yield Paragraph(_NO_CONDITION.format(one=one, two=two), "note")
        yield _tabulate_kept()
    if few := warn_of_few_sensors(len(proposed.lot.sensors), proposed.coverage, proposed.confidence):
        yield Paragraph(few, "warning")


def _describe_limit(limit: ProposedLimit) -> Iterator[Paragraph]:
    label = limit.label
    if limit.far_out:
        other_limits = limit.without_far_out
        limits = (
            "none" if other_limits is None else other_limits.why or _sides(other_limits.lower, other_limits.upper)
        )
        yield Paragraph(_FAR.format(label=label, serials=", ".join(limit.far_out), limits=limits), "warning")
    if limit.uncertainty.standard is None:
        yield Paragraph(_NO_GUARD.format(label=label, why=limit.uncertainty.source), "note")
    elif limit.risks is None:
        yield Paragraph(_NO_RISKS.format(label=label, why=limit.no_risks), "note")
    if limit.lower is not None and limit.lower <= 0 and limit.positive:
        yield Paragraph(_NEGATIVE.format(label=label), "note")
    if exceeds_share(limit.measurement, limit.upper):
        yield Paragraph(_ABOVE_SHARE.format(label=label), "note")
    if limit.present is None:
        yield Paragraph(_BOTH.format(label=label), "note")


def _tabulate_kept() -> Table:
    coverage, confidence = MEASURED_FOR
    rows = [(family, *map(str, percents)) for family, percents in KEPT_PERCENT.items()]
    columns = ("sensors are like", *(f"{size} sensors" for size in LOT_SIZES))
    return text_table(_KEPT.format(coverage=100 * coverage, confidence=100 * confidence), columns, rows, (1, 2, 3))


def _shares(risks: Risks) -> tuple[str, str]:
    return _share(risks.consumer), _share(risks.producer)


def _share(share: float) -> str:
    return f"{100 * share:.2g} %" if share >= _LEAST_SHARE else f"< {100 * _LEAST_SHARE:g} %"


def _limit_words(limit: Limit | None) -> str:
    if limit is None:
        return "none"
    if limit.lower is not None and limit.upper is not None:
        return f"{_exact(limit.lower)} to {_exact(limit.upper)}"
    return _sides(limit.lower, limit.upper)


def _sides(lower: float | None, upper: float | None) -> str:
    return " ".join(f"{sign} {_exact(end)}" for sign, end in (("≥", lower), ("≤", upper)) if end is not None)


def _exact(value: float | None) -> str:
    """Format a limit; proposed ones are rounded already."""
    return _NONE if value is None else f"{value:.6g}".replace("-", "\N{MINUS SIGN}")
