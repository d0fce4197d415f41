"""A straight line through points by least squares, with what is known of it anywhere along it.

    y = a + b (x − x̄),  b = Σ(x − x̄)(y − ȳ)/S_xx,  a = ȳ,  s² = Σ(y − ŷ)²/(n − 2)

About x̄, a and b are independent, and a large origin (dates, offsets) costs no digits.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import fsum, sqrt

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.contrast import Contrast, checked
from cbsr_qa.stats.samples import LEAST_SPREAD, constant, sample
from cbsr_qa.stats.univariate import centred


@dataclass(frozen=True, slots=True)
class Line:
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

    def at(self, x: float) -> Contrast:
        """Return the line at ``x`` with the standard error of the mean there."""
        away = x - self.centre
        error = self.residual * sqrt(1 / self.count + away**2 / self.squares)
        return Contrast(self.level + self.slope * away, error, self.count - 2)

    def rise(self) -> Contrast:
        """Return the slope with its standard error."""
        return Contrast(self.slope, self.residual / sqrt(self.squares), self.count - 2)


def straight_line(x: Iterable[float], y: Iterable[float], what: str = "line") -> Line:
    """Fit a line.

    Parameters
    ----------
    x, y : (n,), n ≥ 3.
    what : what it is of, for messages.

    Raises
    ------
    NumericsError
        Too few points, all at one x, missing values, or points exactly on a line: they leave no variance.
    """
    xs, ys = sample(x, f"{what}, x", least=3), sample(y, f"{what}, y", least=3)
    if len(xs) != len(ys):
        raise NumericsError(f"{what}: {len(xs)} values of x for {len(ys)} of y")
    if constant(xs):
        raise NumericsError(f"{what}: all {len(xs)} points are at {xs[0]:.6g}, which leaves no slope")
    (centre, across), (level, along) = centred(xs), centred(ys)
    squares = fsum(across**2)
    slope = fsum(across * along) / squares
    rest = fsum((along - slope * across) ** 2)
    residual, total = sqrt(rest / (len(xs) - 2)), fsum(along**2)
    if residual <= LEAST_SPREAD * max(abs(level), sqrt(total)):
        raise NumericsError(f"{what}: the points lie on a line of slope {slope:.6g}, which leaves no variance")
    checked(slope, residual / sqrt(squares), len(xs) - 2, what)
    return Line(len(xs), centre, level, slope, residual, squares, 1 - rest / total)
