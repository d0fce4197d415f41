"""A gauge compared with known values: bias, linearity of the bias over the range, and stability over time.

Source: AIAG MSA 4th edition, chapter III, sections B. Reference values are exact unless their uncertainty is stated:
that of one reference shifts the biases of all its readings together (:mod:`cbsr_qa.stats.intervals`).

    y = a + b (x − x̄),  b = Σ(x − x̄)(y − ȳ)/S_xx,  a = ȳ,  s² = Σ(y − ŷ)²/(n − 2)

Centred on x̄, a and b are independent, and a large offset of x loses no digits.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import fsum, hypot, sqrt
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.control_charts import Chart, individuals
from cbsr_qa.stats.difference import Contrast, make_contrast
from cbsr_qa.stats.intervals import Referenced
from cbsr_qa.stats.samples import LEAST_SPREAD, constant, sample, subtract_mean, summary


@dataclass(frozen=True, slots=True)
class RegressionLine:
    """A fitted line.

    Parameters
    ----------
    count : n, at least 3.
    centre : x̄.
    level : a, the line at x̄, in the unit of y.
    slope : b, per unit of x.
    residual : s, in the unit of y.
    squares : S_xx.
    explained : R².
    """

    count: int
    centre: float
    level: float
    slope: float
    residual: float
    squares: float
    explained: float

    def evaluate(self, x: float) -> Contrast:
        """Return the line at ``x`` with the standard error of the mean there."""
        away = x - self.centre
        error = self.residual * sqrt(1 / self.count + away**2 / self.squares)
        return Contrast(self.level + self.slope * away, error, self.count - 2)

    def rise(self) -> Contrast:
        return Contrast(self.slope, self.residual / sqrt(self.squares), self.count - 2)


def straight_line(x: Iterable[float], y: Iterable[float], what: str = "line") -> RegressionLine:
    """Fit a line to (n,) points, n ≥ 3.

    Raises
    ------
    NumericsError
        Too few points, all at one x, missing values, or points exactly on a line (no residual variance).
    """
    xs, ys = sample(x, f"{what}, x", least=3), sample(y, f"{what}, y", least=3)
    if len(xs) != len(ys):
        raise NumericsError(f"{what}: {len(xs)} values of x for {len(ys)} of y")
    if constant(xs):
        raise NumericsError(f"{what}: all {len(xs)} points are at {xs[0]:.6g}, so there is no slope")
    (centre, x_deviations), (level, y_deviations) = subtract_mean(xs), subtract_mean(ys)
    x_squares = fsum(x_deviations**2)
    slope = fsum(x_deviations * y_deviations) / x_squares
    residual_squares = fsum((y_deviations - slope * x_deviations) ** 2)
    residual, total = sqrt(residual_squares / (len(xs) - 2)), fsum(y_deviations**2)
    if residual <= LEAST_SPREAD * max(abs(level), sqrt(total)):
        raise NumericsError(f"{what}: the points lie on a line of slope {slope:.6g}, so there is no variance")
    make_contrast(slope, residual / sqrt(x_squares), len(xs) - 2, what)
    return RegressionLine(len(xs), centre, level, slope, residual, x_squares, 1 - residual_squares / total)


@dataclass(frozen=True, slots=True)
class Linearity:
    """Bias as a function of the measured value.

    Parameters
    ----------
    line : line of bias over reference value, as if references were exact.
    references : the distinct ones, ascending.
    known : (readings, value, standard uncertainty) of each reference whose uncertainty was stated.
    """

    line: RegressionLine
    references: tuple[float, ...]
    known: tuple[tuple[int, float, float], ...] = ()

    @property
    def intercept(self) -> Referenced:
        """Return the bias at a reference value of zero."""
        return self.evaluate(0.0)

    def rise(self) -> Referenced:
        """Return the slope of the bias; its standard error includes the references' uncertainties."""
        return self._widen(self.line.rise(), 0.0, 1 / self.line.squares)

    def evaluate(self, reference: float) -> Referenced:
        """Return the bias at a reference value; its standard error includes the references' uncertainties."""
        line = self.line
        return self._widen(line.evaluate(reference), 1 / line.count, (reference - line.centre) / line.squares)

    def _widen(self, contrast: Contrast, level: float, slope: float) -> Referenced:
        """Add the uncertainty of references whose readings have weights level + slope (x − x̄).

        A reference that is u too high reads (1 + b) u too low, b the slope.
        """
        line = self.line
        contributions = [n * (level + slope * (x - line.centre)) * (1 + line.slope) * u for n, x, u in self.known]
        return Referenced(contrast.value, contrast.standard_error, contrast.freedom, hypot(*contributions))

    def acceptable(self, confidence: float = 0.95) -> bool:
        """Whether a bias of zero lies within the confidence band at every reference value."""
        return all(self.evaluate(reference).interval(confidence).holds(0.0) for reference in self.references)


#: Smallest number of readings for a chart; with fewer, its limits come from the same few and it hardly ever signals.
FEWEST_CHARTED: Final = 8


@dataclass(frozen=True, slots=True)
class Stability:
    """Stability of one reference over time.

    Parameters
    ----------
    drift : slope of the bias, per day.
    bias : bias of all readings.
    chart : chart of the bias in order of time; limits from its reference period.
    """

    drift: Contrast
    bias: Referenced
    chart: Chart

    @property
    def in_control(self) -> bool | None:
        """Whether the chart gives no signal; None with too few readings."""
        return None if len(self.chart.points) < FEWEST_CHARTED else self.chart.in_control


def bias(readings: Iterable[float], reference: float, what: str = "bias", *, uncertainty: float = 0.0) -> Referenced:
    """Return mean reading − reference, with s/√n of the readings and the uncertainty of the reference.

    Parameters
    ----------
    readings : repeated ones of one reference, at least two.
    uncertainty : one standard deviation of ``reference``, in its unit.

    Raises
    ------
    NumericsError
        Too few or missing readings, or readings that do not differ.
    """
    array = sample(readings, what, least=2, spread=True)
    moments = summary(array, what)
    scatter = float(moments.deviation or 0) / sqrt(len(array))
    contrast = make_contrast(moments.mean - reference, scatter, len(array) - 1, what)
    return Referenced(contrast.value, contrast.standard_error, contrast.freedom, uncertainty)


def linearity(
    references: Sequence[float], readings: Sequence[float], *, known: Sequence[tuple[int, float, float]] = ()
) -> Linearity:
    """Return the bias as a function of the reference value.

    Parameters
    ----------
    references, readings : (n,) reference value and reading; at least two distinct references.
    known : (readings, value, standard uncertainty) of references that are not exact.

    Raises
    ------
    NumericsError
        One reference only, fewer than three or missing readings, or biases that lie exactly on a line.
    """
    label = "linearity"
    values = sample(references, f"{label}, reference values")
    distinct = tuple(float(value) for value in np.unique(values))
    if len(distinct) < 2:
        raise NumericsError(f"{label}: all readings have one reference", remedy="measure references over the range")
    biases = sample(readings, label, least=3)
    if len(values) != len(biases):
        raise NumericsError(f"{label}: {len(values)} reference values for {len(biases)} readings")
    return Linearity(straight_line(values, biases - values, label), distinct, tuple(known))


def stability(times_day: Sequence[float], readings: Sequence[float], reference: float) -> Stability:
    """Return drift and control chart of one reference.

    Parameters
    ----------
    times_day : (n,) times in days from any origin, in any order.
    readings : (n,), n ≥ 3.

    Raises
    ------
    NumericsError
        Too few or missing readings, all at one time, or readings that do not differ.
    """
    label = "stability"
    sample(readings, label, least=3)
    line = straight_line(times_day, readings, label)
    order = np.argsort(np.asarray(times_day, dtype=float), kind="stable")
    ordered = np.asarray(readings, dtype=float)[order]
    chart = individuals(ordered - reference, what=label)
    return Stability(line.rise(), bias(ordered, reference, label), chart)
