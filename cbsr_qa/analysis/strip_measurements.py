"""Measurements of a characterisation, for limits to judge."""

from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.results import (
    STRIP_MEASURES,
    Bound,
    Characterisation,
    FittedLine,
    Measurement,
    StrainLevel,
    StrainSettling,
)
from cbsr_qa.domain.sensor import Parameter, Response

_BETWEEN_PINS: Final = "between the pins"
_UNDER_HEAD: Final = "under the head, by the forward model of the strip"


def measure_characterisation(found: Characterisation) -> tuple[Measurement, ...]:
    """Return the measurements of a characterisation; undetermined ones have no value and give the reason."""
    return (
        *_lines(found),
        *_strip(found),
        *(_level(level) for level in found.levels),
        *(_settling(one) for one in found.settlings),
        *_counts(found),
    )


def _lines(found: Characterisation) -> Iterator[Measurement]:
    blocked = found.refused[0] if found.response is Response.AUTO and found.refused else ""
    for name, line, how in (
        ("gauge_factor", found.against_strain, f"slope against strain, {_BETWEEN_PINS}; steady levels of fits"),
        ("local_gauge_factor", found.local_against_strain, f"slope against strain, {_UNDER_HEAD}"),
        ("stress_sensitivity", found.against_stress, f"slope against stress, {_BETWEEN_PINS}"),
        ("local_stress_sensitivity", found.local_against_stress, f"slope against stress, {_UNDER_HEAD}"),
    ):
        yield from _line(name, line, how, blocked)
    for line, since in zip(found.end_of_hold, ("from before the press", "from the rested strip"), strict=True):
        how = f"slope against strain, {_BETWEEN_PINS}; readings at the end of the hold"
        yield next(_line("gauge_factor", line, how, blocked, f"end of hold, {since}"))
    yield _relative_error(found)


def _line(name: str, fitted: FittedLine, how: str, blocked: str, qualifier: str = "") -> Iterator[Measurement]:
    line = None if blocked else fitted.line
    unit = STRIP_MEASURES[name]
    if line is None:
        yield Measurement(name, None, unit, qualifier=qualifier, how=blocked or fitted.why)
        return
    parts = ", ".join(f"{part} {error:.2g}" for part, error in fitted.parts)
    yield Measurement(
        name, line.slope.value, unit, line.slope.stderr, qualifier=qualifier, how=f"{how}; ± of {parts}"
    )
    yield Measurement(f"{name}_intercept", line.intercept.value, "1", line.intercept.stderr, how=how)


def _relative_error(found: Characterisation) -> Measurement:
    """Relative standard error of the slope, without the assumed contacts: they affect all slopes equally.

    Of a characterisation that cannot stand for its material there is none, so that a limit on it is not met.
    """
    name, fitted = "gauge_factor_error", found.local_against_strain
    if found.refused or fitted.line is None:
        return Measurement(name, None, "%", how=next(iter(found.refused), fitted.why))
    measured = sum(error**2 for part, error in fitted.parts if part != "contacts of the pins") ** 0.5
    how = "standard error of the local gauge factor over itself, without what is assumed of the pins' contacts"
    return Measurement(name, 100 * measured / abs(fitted.line.slope.value), "%", how=how)


def _strip(found: Characterisation) -> Iterator[Measurement]:
    strip, resistance = found.strip, found.strip.resistance_ohm
    yield Measurement(
        "interelectrode_resistance", resistance.value, "ohm", resistance.stderr, how="between the pins, rested"
    )
    how = (
        f"of {strip.squares:.4g} squares between the pins, {100 * strip.contact_share:.2g} % of it in their contacts"
    )
    yield Measurement("sheet_resistance", resistance.value / strip.squares, "ohm", how=how)
    yield Measurement("reading_noise", strip.relative_noise, "1", how="rms over mean of the rested readings")
    yield _parameter("compressive_modulus", found.modulus_kPa, "slope of steady stress against strain", found)
    yield _parameter("strain_offset", found.strain_offset, "strain at which that line crosses zero stress", found)
    if found.residue is not None:
        share, decay = found.residue
        how = f"share of a release that fades with {decay.value:.3g} ± {decay.stderr or 0:.2g} s"
        yield Measurement("slow_residue", share.value, "1", share.stderr, how=how)


def _parameter(name: str, parameter: Parameter | None, how: str, found: Characterisation) -> Measurement:
    if parameter is None:
        why = next((said for said in found.refused if "modulus" in said), "the stress is not known")
        return Measurement(name, None, STRIP_MEASURES[name], how=why)
    return Measurement(name, parameter.value, STRIP_MEASURES[name], parameter.stderr, how=how)


def _level(level: StrainLevel) -> Measurement:
    error = level.deviation / level.cycles**0.5 if level.cycles > 1 else None
    return Measurement(
        "conductance_change",
        level.mean,
        "1",
        error,
        qualifier=f"{100 * level.strain:g} % strain",
        how=level.why or f"{_BETWEEN_PINS}, mean of {level.cycles} cycles",
        strain=level.strain,
    )


def _settling(one: StrainSettling) -> Measurement:
    name = "common_settling_time" if one.strain is None else "settling_time"
    at = "" if one.strain is None else f", {100 * one.strain:g} % strain"
    constants = " and ".join(f"{tau:.3g} s" for tau in one.fit.time_constants_s)
    how = f"{one.fit.status}{f', {constants}' if constants else ''}; {one.traces} cycles fitted together"
    return Measurement(
        name,
        one.settling.value_s,
        "s",
        one.stderr_s,
        qualifier=f"{one.words}{at}",
        how=f"{how}; {one.settling.why}".removesuffix("; "),
        bound=Bound.LOWER if one.settling.censored else Bound.EXACT,
        strain=one.strain,
    )


def _counts(found: Characterisation) -> Iterator[Measurement]:
    excluded = [level.why for level in found.levels if level.why]
    used = sum(level.cycles for level in found.levels if not level.why)
    lost = sum(level.cycles for level in found.levels if level.why) + len(found.unread)
    yield Measurement("cycles_used", float(used), "1", how="cycles the lines are drawn through")
    yield Measurement(
        "cycles_excluded", float(lost), "1", how="; ".join((*found.unread, *excluded)) or "none left out"
    )
    yield Measurement("strains_excluded", float(len(excluded)), "1", how="; ".join(excluded) or "none left out")
    how = "least strain at which α ε + β is three standard errors from zero"
    yield Measurement("lowest_strain", found.lowest_strain, "1", how=how)
