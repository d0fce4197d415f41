"""Cells, numbers and words that sections write alike: as many digits as the uncertainty allows, with a unit."""

from collections.abc import Callable, Iterable, Sequence
from math import floor, isinf, log10
from typing import Final, Protocol, TypeVar

from cbsr_qa.domain.plan.limits import Bound, Limit
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.report import Cell, Table

T = TypeVar("T")

_MINUS: Final = "\N{MINUS SIGN}"
_SUPERSCRIPTS: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

#: SI prefixes by power of ten.
_PREFIXES: Final = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}

#: Units that take a prefix; lengths and times stay in the unit their name states.
_SCALABLE: Final = frozenset({"V", "A", "S", "ohm", "Ω"})

#: Decimals beyond which a value in this unit means nothing on this bench, unless its uncertainty is smaller.
_DECIMALS: Final = {"mm": 2, "mm²": 2, "mm2": 2, "%": 1, "percent": 1, "dB": 1, "s": 1, "N": 2, "kPa": 1}

#: Degrees of freedom above which k is that of infinitely many, within 0.003.
_MANY_DOF: Final = 999

#: Number of names that are listed; the rest is only counted.
_MOST_NAMED: Final = 6

#: Units as they are written.
_SHOWN: Final = {"1": "", "ohm": "Ω", "percent": "%", "mm2": "mm²", "dB": "dB", "degC": "°C", "count": "counts"}


def unit_shown(unit: str) -> str:
    """Return a unit as it is printed; empty for pure numbers."""
    return _SHOWN.get(unit, unit)


def number(value: float, digits: int = 3) -> str:
    """Write a number with this many significant digits; large and small ones as a power of ten."""
    if value == 0:
        return "0"
    exponent = floor(log10(abs(value)))
    rounded = round(value, digits - 1 - exponent)
    exponent = floor(log10(abs(rounded)))
    if -4 < exponent < 5:
        return format_fixed(rounded, max(digits - 1 - exponent, 0))
    return f"{format_fixed(rounded / 10.0**exponent, digits - 1)} × 10{str(exponent).translate(_SUPERSCRIPTS)}"


def format_fixed(value: float, decimals: int) -> str:
    """Write a number with this many decimals and a true minus sign; a rounded zero has no sign."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", _MINUS)


def plain(value: float, unit: str) -> str:
    """Write a value without a stated uncertainty: three digits, but no more decimals than its unit deserves."""
    most_decimals = _DECIMALS.get(unit)
    if most_decimals is None or abs(value) >= 1e5 or value == 0:
        return number(value)
    if round(value, most_decimals) == 0:
        return number(value, 1)
    return format_fixed(value, min(most_decimals, max(2 - floor(log10(abs(value))), 0)))


def with_uncertainty(value: float, uncertainty: float | None, digits: int = 3) -> str:
    """Write value ± one standard deviation, both to the uncertainty's second significant digit at most.

    The uncertainty keeps two digits where its first is 1 or 2, else one (the rule of the Particle Data Group,
    rounded to leading digits). Without an uncertainty, or with 0, the value gets ``digits`` digits.
    """
    if uncertainty is None or uncertainty <= 0:
        return number(value, digits)
    first_exponent = floor(log10(uncertainty))
    keep = 1 if round(uncertainty / 10.0**first_exponent, 6) < 3 else 0  # 0.3 is stored as a little less
    decimals = keep - first_exponent
    largest = max(abs(value), uncertainty)
    if largest < 1e5 and (decimals <= 5 or largest >= 1.0):  # a power would not make these shorter
        return f"{format_fixed(value, max(decimals, 0))} ± {format_fixed(uncertainty, max(decimals, 0))}"
    exponent = floor(log10(largest))
    scale = 10.0**exponent
    places = max(decimals + exponent, 0)
    power = f"10{str(exponent).translate(_SUPERSCRIPTS)}"
    return f"({format_fixed(value / scale, places)} ± {format_fixed(uncertainty / scale, places)}) × {power}"


def format_dof(dof: float | None) -> str:
    """Write degrees of freedom, truncated as k is (JCGM 100, G.6.4); None and infinity alike."""
    if dof is None or isinf(dof):
        return "∞"
    return f">{_MANY_DOF}" if dof > _MANY_DOF else str(floor(dof))


def quantity(value: float, unit: str, uncertainty: float | None = None) -> str:
    """Write a number with its unit; volts, amperes, siemens and ohms get a prefix (18.1 kΩ)."""
    scale, shown_unit = scale_unit(value, unit)
    if not uncertainty and scale == 1:
        text = plain(value, unit)
    else:
        text = with_uncertainty(value / scale, None if uncertainty is None else uncertainty / scale)
    gap = "\N{NO-BREAK SPACE}" if shown_unit else ""
    return f"{text}{gap}{shown_unit}"


def scale_unit(value: float, unit: str) -> tuple[float, str]:
    """Return what to divide by, and the unit to print, so that a value of this size reads well."""
    if unit not in _SCALABLE or value == 0:
        return 1.0, unit_shown(unit)
    thousands = min(max(3 * floor(log10(abs(value)) / 3 + 1e-12), -9), 9)
    return 10.0**thousands, f"{_PREFIXES[thousands]}{unit_shown(unit)}"


def duration(seconds: float) -> str:
    """Write a time span: ``0.42 s``, ``42 s``, ``18 min 20 s``, ``5 h 24 min``."""
    if seconds < 10:
        return f"{number(seconds, 2)} s"
    whole_s = round(seconds)
    if whole_s < 60:
        return f"{whole_s} s"
    if whole_s < 3600:
        minutes, rest = divmod(whole_s, 60)
        return f"{minutes} min" + (f" {rest} s" if rest else "")
    hours, rest = divmod(round(seconds / 60), 60)
    return f"{hours} h" + (f" {rest} min" if rest else "")


def plural(count: int, one: str, many: str = "") -> str:
    """Write a count with its noun: ``no loads``, ``1 load``, ``9 loads``."""
    noun = one if count == 1 else many or f"{one}s"
    return f"{count or 'no'} {noun}"


def format_or_dash(value: T | None, write: Callable[[T], str]) -> str:
    """Write a value; a dash for None."""
    return "–" if value is None else write(value)


class Uncertain(Protocol):
    """A value whose standard error may be stated."""

    @property
    def value(self) -> float:
        """The estimate."""

    @property
    def stderr(self) -> float | None:
        """Its standard error, in the same unit."""


def parameter_text(parameter: Uncertain | None, scale: float = 1.0) -> str:
    """Write an estimate times ``scale`` with its standard error; a dash for None."""
    if parameter is None:
        return "–"
    stderr = None if parameter.stderr is None else scale * parameter.stderr
    return with_uncertainty(scale * parameter.value, stderr)


def place_text(x_mm: float, y_mm: float) -> str:
    """Write a place: ``17.5, −10``."""
    return f"{x_mm:g}, {y_mm:g}".replace("-", _MINUS)


def list_names(names: Sequence[str], most: int = _MOST_NAMED) -> str:
    """List names; of very many the first ones."""
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")


def capital(text: str) -> str:
    """Begin with a capital letter; the rest stays, also where it is a name."""
    return f"{text[:1].upper()}{text[1:]}"


def text_table(
    caption: str, columns: Sequence[str], rows: Sequence[Sequence[str | Cell]], numeric: Sequence[int] = ()
) -> Table:
    """Make a table from plain strings and cells."""
    cells = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in rows)
    return Table(caption, tuple(columns), cells, tuple(numeric))


def value_cell(measurement: Measurement | None, *, unit: bool = False) -> Cell:
    """Write a measurement's value, coloured by its outcome; a dash if not taken."""
    if measurement is None:
        return Cell("–")
    outcome = measurement.outcome if measurement.limit is not None else None
    if measurement.value is None:
        return Cell("not measured", outcome)
    return Cell(f"{sign_of_bound([measurement])}{_value_text(measurement, measurement.value, unit)}", outcome)


def sign_of_bound(measurements: Iterable[Measurement]) -> str:
    """Return ``"≥ "`` where any of some values is only a lower bound: their mean is one too."""
    return "≥ " if any(m.bound is Bound.LOWER and m.value is not None for m in measurements) else ""


def _value_text(measurement: Measurement, value: float, unit: bool) -> str:
    if unit:
        return quantity(value, measurement.unit, measurement.uncertainty)
    if measurement.uncertainty:
        return with_uncertainty(value, measurement.uncertainty)
    return plain(value, measurement.unit)


def limit_text(limit: Limit) -> str:
    """Write a limit: ``≤ 5 mm``, ``50 to 100 %``."""
    bounds = [b for b in (limit.lower, limit.upper) if b is not None]
    scale, shown_unit = scale_unit(max(bounds, key=abs), limit.unit)
    gap = "\N{NO-BREAK SPACE}" if shown_unit else ""
    bound_texts = [f"{bound / scale:.4g}".replace("-", "\N{MINUS SIGN}") for bound in bounds]  # as it was set
    sign = "" if len(bounds) > 1 else "≥ " if limit.lower is not None else "≤ "
    return f"{sign}{' to '.join(bound_texts)}{gap}{shown_unit}"


def margin_text(measurement: Measurement) -> str:
    """Write the distance from the nearer bound, negative outside; empty without one.

    The margin of a lower bound that fails is written too: the value is at least that far outside.
    """
    if measurement.limit is None or measurement.value is None:
        return ""
    margin = measurement.limit.margin(measurement.value)
    if measurement.bound is Bound.LOWER and margin >= 0:
        return ""
    return f"{'+' if margin > 0 else ''}{quantity(margin, measurement.unit)}"


def unit_column(name: str, unit: str) -> str:
    """Head a column: ``E_CoM [mm]``."""
    shown_unit = unit_shown(unit)
    return f"{name} [{shown_unit}]" if shown_unit else name
