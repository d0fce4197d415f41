"""Measurements of a characterisation, for limits to judge."""

from collections.abc import Iterator
from typing import Final

from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa.domain.results.characterisation import (
    STRIP_MEASURES,
    Characterisation,
    FittedLine,
    StrainLevel,
    StrainSettling,
)
from cbsr_qa.domain.results.dimensions import Dimensions
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.sensor.sensor_type import Parameter, Response

_BETWEEN_PINS: Final = "between the pins"
_UNDER_HEAD: Final = "under the head, by the forward model of the strip"


def measure_characterisation(material: Characterisation) -> tuple[Measurement, ...]:
    """Return the measurements of a characterisation; undetermined ones have no value and give the reason."""
    return (
        *_lines(material),
        *_strip(material),
        *(_level(level) for level in material.levels),
        *(_settling(each) for each in material.settlings),
        *_counts(material),
    )


def _lines(material: Characterisation) -> Iterator[Measurement]:
    blocked = material.refused[0] if material.response is Response.AUTO and material.refused else ""
    for name, line, how in (
        ("gauge_factor", material.against_strain, f"slope against strain, {_BETWEEN_PINS}; steady levels of fits"),
        ("local_gauge_factor", material.local_against_strain, f"slope against strain, {_UNDER_HEAD}"),
        ("stress_sensitivity", material.against_stress, f"slope against stress, {_BETWEEN_PINS}"),
        ("local_stress_sensitivity", material.local_against_stress, f"slope against stress, {_UNDER_HEAD}"),
    ):
        yield from _line(name, line, how, blocked)
    for line, since in zip(material.end_of_hold, ("from before the press", "from the rested strip"), strict=True):
        how = f"slope against strain, {_BETWEEN_PINS}; readings at the end of the hold"
        yield next(_line("gauge_factor", line, how, blocked, f"end of hold, {since}"))
    yield _relative_error(material)


def _line(name: str, fitted: FittedLine, how: str, blocked: str, qualifier: str = "") -> Iterator[Measurement]:
    line = None if blocked else fitted.line
    unit = STRIP_MEASURES[name]
    if line is None:
        yield Measurement(name, None, unit, qualifier=qualifier, how=blocked or fitted.why)
        return
    error_parts = ", ".join(f"{part} {error:.2g}" for part, error in fitted.parts)
    yield Measurement(
        name, line.slope.value, unit, line.slope.stderr, qualifier=qualifier, how=f"{how}; ± of {error_parts}"
    )
    yield Measurement(f"{name}_intercept", line.intercept.value, "1", line.intercept.stderr, how=how)


def _relative_error(material: Characterisation) -> Measurement:
    """Relative standard error of the slope, without the assumed contacts: they affect all slopes equally.

    The value is None if a characterisation does not represent its material, so that a limit on it is not met.
    """
    name, fitted_line = "gauge_factor_error", material.local_against_strain
    if material.refused or fitted_line.line is None:
        return Measurement(name, None, "%", how=next(iter(material.refused), fitted_line.why))
    measured = sum(error**2 for part, error in fitted_line.parts if part != "contacts of the pins") ** 0.5
    how = "standard error of the local gauge factor over itself, without what is assumed of the pins' contacts"
    return Measurement(name, 100 * measured / abs(fitted_line.line.slope.value), "%", how=how)


def _strip(material: Characterisation) -> Iterator[Measurement]:
    strip, resistance = material.strip, material.strip.resistance_ohm
    yield Measurement(
        "interelectrode_resistance", resistance.value, "ohm", resistance.stderr, how="between the pins, rested"
    )
    how = (
        f"of {strip.squares:.4g} squares between the pins, {100 * strip.contact_share:.2g} % of it in their contacts"
    )
    yield Measurement("sheet_resistance", resistance.value / strip.squares, "ohm", how=how)
    yield Measurement("reading_noise", strip.relative_noise, "1", how="rms over mean of the rested readings")
    yield _parameter("compressive_modulus", material.modulus_kPa, "slope of steady stress against strain", material)
    yield _parameter(
        "strain_offset", material.strain_offset, "strain at which that line crosses zero stress", material
    )
    if material.residue is not None:
        share, decay = material.residue
        how = f"share of a release that fades with {decay.value:.3g} ± {decay.stderr or 0:.2g} s"
        yield Measurement("slow_residue", share.value, "1", share.stderr, how=how)


def _parameter(name: str, parameter: Parameter | None, how: str, material: Characterisation) -> Measurement:
    if parameter is None:
        why = next((reason for reason in material.refused if "modulus" in reason), "the stress is not known")
        return Measurement(name, None, STRIP_MEASURES[name], how=why)
    return Measurement(name, parameter.value, STRIP_MEASURES[name], parameter.stderr, how=how)


def _level(level: StrainLevel) -> Measurement:
    error = level.deviation / level.cycles**0.5 if level.cycles > 1 else None
    return Measurement(
        "conductance_change",
        level.mean,
        "1",
        error,
        qualifier=Dimensions(strain=level.strain).text,
        how=level.why or f"{_BETWEEN_PINS}, mean of {level.cycles} cycles",
        strain=level.strain,
    )


def _settling(each: StrainSettling) -> Measurement:
    name = "common_settling_time" if each.strain is None else "settling_time"
    direction = "loading" if each.loading else "unloading"
    constants = " and ".join(f"{tau:.3g} s" for tau in each.fit.time_constants_s)
    how = f"{each.fit.status}{f', {constants}' if constants else ''}; {each.traces} cycles fitted together"
    return Measurement(
        name,
        each.settling.value_s,
        "s",
        each.stderr_s,
        qualifier=Dimensions(each.signal, direction, strain=each.strain).text,
        how=f"{how}; {each.settling.why}".removesuffix("; "),
        bound=Bound.LOWER if each.settling.censored else Bound.EXACT,
        strain=each.strain,
    )


def _counts(material: Characterisation) -> Iterator[Measurement]:
    exclusion_reasons = [level.why for level in material.levels if level.why]
    used_count = sum(level.cycles for level in material.levels if not level.why)
    excluded_count = sum(level.cycles for level in material.levels if level.why) + len(material.unread)
    yield Measurement("cycles_used", float(used_count), "1", how="cycles the lines are drawn through")
    yield Measurement(
        "cycles_excluded",
        float(excluded_count),
        "1",
        how="; ".join((*material.unread, *exclusion_reasons)) or "none left out",
    )
    yield Measurement(
        "strains_excluded", float(len(exclusion_reasons)), "1", how="; ".join(exclusion_reasons) or "none left out"
    )
    how = "least strain at which α ε + β is three standard errors from zero"
    yield Measurement("lowest_strain", material.lowest_strain, "1", how=how)
