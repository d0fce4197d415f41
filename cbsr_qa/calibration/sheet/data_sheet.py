"""Data-sheet numbers of a sensor from repeated loads, and the evenness of its sheet's response."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.sheet.baseline import load_baseline, measure_sensed_change
from cbsr_qa.domain import Array, NumericsError, finite_numbers
from cbsr_qa.domain.geometry import overlap_mm2
from cbsr_qa.domain.results import LoadObservation, RunObservation

#: Fewest points of a characteristic: a straight line fits any two.
FEWEST_POINTS: Final = 3
#: More points than this are not searched by triples.
_MOST_POINTS: Final = 100


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its uncertainty.

    Parameters
    ----------
    stderr : one standard deviation, or None if unknown.
    degrees : of freedom of the stated scatter.
    """

    value: float
    stderr: float | None
    degrees: int


@dataclass(frozen=True, slots=True, eq=False)
class StraightLine:
    """A straight line through a characteristic, and the deviations from it.

    Parameters
    ----------
    deviations : (n,) float64, points minus line, in the unit of y.
    largest : of their absolute values.
    stderr : of ``largest``, with the deciding points held fixed: too large if several compete, never too small. None
        if the points' errors are unknown.
    """

    slope: float
    intercept: float
    deviations: Array
    largest: float
    stderr: float | None


def pool_deviations(cells: Sequence[Sequence[float]]) -> Estimate:
    """Standard deviation within cells, pooled: s² = Σ (n_c − 1) s_c² / Σ (n_c − 1) (ISO 5725-2, 7.4.5).

    NumericsError if no cell has two values, or a value is not finite.
    """
    repeated = [finite_numbers(cell, "values of a cell") for cell in cells if len(cell) > 1]
    degrees = sum(len(cell) - 1 for cell in repeated)
    if not degrees:
        raise NumericsError(
            "nothing was pressed twice at the same place and strain", remedy="give the recipe trials = 2 or more"
        )
    deviation = float(np.sqrt(sum(((cell - cell.mean()) ** 2).sum() for cell in repeated) / degrees))
    return Estimate(deviation, deviation / float(np.sqrt(2 * degrees)), degrees)


def best_straight_line(x: Sequence[float], y: Sequence[float], stderr: Sequence[float] | None = None) -> StraightLine:
    """Fit the line whose largest deviation is smallest: the best straight line of independent linearity (ISA-51.1).

    By Chebyshev's alternation theorem three points decide it: those whose own levelled deviation, ½ |y₂ − λ y₁ −
    (1 − λ) y₃| with λ = (x₃ − x₂)/(x₃ − x₁), is the largest of all triples. All triples are tried, so it is exact.

    NumericsError with fewer than 3 points or more than 100, lengths that differ, a number that is not finite, or x
    that coincide.

    Parameters
    ----------
    x, y : (n,) n ≥ 3 points, in any order.
    stderr : (n,) standard errors of y, or None if unknown.
    """
    place, value, error, order = _sort_points(x, y, stderr)
    triples = np.array(list(combinations(range(len(place)), 3)))
    first, middle, last = triples.T
    share = (place[last] - place[middle]) / (place[last] - place[first])
    levelled = (value[middle] - share * value[first] - (1 - share) * value[last]) / 2
    chosen = int(np.argmax(np.abs(levelled)))
    left, _, right = triples[chosen]
    slope = float((value[right] - value[left]) / (place[right] - place[left]))
    of_largest = _combine_errors(error, triples[chosen], float(share[chosen]), 0.5)
    return _line(slope, (place[left], value[left]), float(levelled[chosen]), place, value, order, of_largest)


def terminal_line(x: Sequence[float], y: Sequence[float], stderr: Sequence[float] | None = None) -> StraightLine:
    """Draw the line through the first and the last point: terminal-based linearity (ISA-51.1).

    Parameters and errors are those of :func:`best_straight_line`.
    """
    place, value, error, order = _sort_points(x, y, stderr)
    slope = float((value[-1] - value[0]) / (place[-1] - place[0]))
    furthest = int(np.argmax(np.abs(value - value[0] - slope * (place - place[0]))))
    share = float((place[-1] - place[furthest]) / (place[-1] - place[0]))
    of_largest = _combine_errors(error, np.array([0, furthest, len(place) - 1]), share, 1.0)
    return _line(slope, (place[0], value[0]), 0.0, place, value, order, of_largest)


def ratio_of_sums(parts: Sequence[float], wholes: Sequence[float]) -> Estimate:
    """Σ parts / Σ wholes: a ratio over many loads in which each counts by its size.

    A mean of single ratios would be dominated by the weakest loads, whose ratio is mostly noise. The standard error
    is that of the ratio estimator, √(n/(n − 1) Σ (pᵢ − r wᵢ)²) / Σ wᵢ (Cochran 1977, 6.4); None for a single load.

    NumericsError if there is nothing, lengths differ, a number is not finite, or the wholes sum to zero.
    """
    part, whole = finite_numbers(parts, "parts"), finite_numbers(wholes, "wholes")
    if len(part) != len(whole):
        raise NumericsError(f"{len(part)} parts and {len(whole)} wholes do not fit together")
    total = float(whole.sum())
    if not total > 0:
        raise NumericsError(f"the changes under load sum to {total:.3g}: no share can be computed")
    ratio, count = float(part.sum()) / total, len(part)
    if count < 2:
        return Estimate(ratio, None, 0)
    scatter = float(np.sqrt(count / (count - 1) * ((part - ratio * whole) ** 2).sum()))
    return Estimate(ratio, scatter / total, count - 1)


def relative_spread(values: Sequence[float]) -> Estimate:
    """Standard deviation over mean; its standard error is that of normal values, c √((½ + c²)/(n − 1)).

    NumericsError with fewer than three values, a mean that is not positive, or a value that is not finite.
    """
    value = finite_numbers(values, "values of the locations")
    if len(value) < 3:
        raise NumericsError(f"a spread needs three locations; {len(value)} of them gave a value")
    mean = float(value.mean())
    if not mean > 0:
        raise NumericsError(f"the mean over the locations is {mean:.3g}, which nothing can be a share of")
    share, degrees = float(value.std(ddof=1)) / mean, len(value) - 1
    return Estimate(share, share * float(np.sqrt((0.5 + share**2) / degrees)), degrees)


def slope(x: Sequence[float], y: Sequence[float]) -> Estimate:
    """Slope of y against x by ordinary least squares with an intercept; two points give no error.

    NumericsError if all x coincide, or a number is not finite.
    """
    place, value = finite_numbers(x, "places of a slope"), finite_numbers(y, "values of a slope")
    centred = place - place.mean()
    square = float(centred @ centred)
    if not square > (1e-9 * float(np.abs(place).max(initial=1e-300))) ** 2 * len(place):
        raise NumericsError("a slope needs loads at two strains", remedy="press at clearly different strains")
    apart = value - value.mean()
    rate = float(centred @ apart) / square
    degrees = len(place) - 2
    if degrees < 1:
        return Estimate(rate, None, 0)
    left = apart - rate * centred
    return Estimate(rate, float(np.sqrt(left @ left / degrees / square)), degrees)


def _sort_points(
    x: Sequence[float], y: Sequence[float], stderr: Sequence[float] | None
) -> tuple[Array, Array, Array | None, NDArray[np.intp]]:
    place, value = finite_numbers(x, "places of a characteristic"), finite_numbers(y, "its values")
    error = None if stderr is None else finite_numbers(stderr, "errors of a characteristic")
    if len(place) != len(value) or (error is not None and len(error) != len(place)):
        raise NumericsError("the points of a characteristic and their errors do not fit together")
    if not FEWEST_POINTS <= len(place) <= _MOST_POINTS:
        raise NumericsError(
            f"needs {FEWEST_POINTS} to {_MOST_POINTS} strains; there are {len(place)}",
            remedy=f"press at {FEWEST_POINTS} strains or more",
        )
    order = np.argsort(place, kind="stable")
    if (np.diff(place[order]) <= 1e-9 * np.abs(place).max()).any():
        raise NumericsError("two strains have the same stress")
    return place[order], value[order], None if error is None else error[order], order


def _combine_errors(error: Array | None, triple: NDArray[np.intp], share: float, factor: float) -> float | None:
    if error is None:
        return None
    weights = factor * np.array([share, 1.0, 1 - share])
    return float(np.sqrt(((weights * error[triple]) ** 2).sum()))


def _line(
    rate: float,
    point: tuple[float, float],
    above: float,
    place: Array,
    value: Array,
    order: NDArray[np.intp],
    stderr: float | None,
) -> StraightLine:
    """Return the line at a distance above a point; deviations are relative to it, not to a far intercept."""
    deviations = np.empty_like(value)
    deviations[order] = value - point[1] - rate * (place - point[0]) - above
    intercept = float(point[1] - rate * point[0] + above)
    return StraightLine(rate, intercept, deviations, float(np.abs(deviations).max()), stderr)


#: Share of the peak of a head's modelled image: regions with a smaller mean are not on the head.
_ON_HEAD: Final = 0.5


@dataclass(frozen=True, slots=True)
class PlaceResponse:
    """Response of a location to one strain.

    Parameters
    ----------
    location, x_mm, y_mm : of its loads.
    baseline : ρ₀ of Eq 7, mean over the loads, relative image units.
    responses : of each load, the same over the image of the linearised model of an even sheet there: 1 if the sheet
        responds as that model with the material's α.
    """

    location: str
    x_mm: float
    y_mm: float
    baseline: float
    responses: tuple[float, ...]

    @property
    def response(self) -> float:
        """Mean over the loads."""
        return float(np.mean(self.responses))


def place_responses(run: RunObservation, loads: Sequence[LoadObservation]) -> tuple[tuple[PlaceResponse, ...], float]:
    """Response of every location at the most common strain, the highest of several such.

    NumericsError if no load gave a ρ₀.

    Returns
    -------
    Locations in the order of their first press, and the strain. Loads without a ρ₀, or sensed off the head (the
    model's mean over the sensed elements is under half of its peak), are left out.
    """
    by_strain: dict[float, dict[tuple[str, float, float], list[tuple[float, float]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    why = "no location was pressed at a nominal strain by itself"
    modelled: dict[tuple[float, float], np.ndarray] = {}
    for load in loads:
        stress = run.record.material.against_stress
        baseline = load_baseline(load, stress, run.noise_images, run.main_mask)
        view = load.mask(run.main_mask)
        if baseline.value is None or view is None or view.sensed is None:
            why = baseline.why
            continue
        if load.place_mm not in modelled:
            modelled[load.place_mm] = _image_of_head(run, load)
        image = modelled[load.place_mm]
        gain = float(measure_sensed_change(image, view.sensed, load.response))
        if not gain > _ON_HEAD * float(np.abs(image).max()):
            why = f"{load.record.load.label} was not sensed under its head"
            continue
        place = (load.record.load.label, *load.place_mm)
        by_strain[round(load.record.load.strain, 9)][place].append((baseline.value, baseline.value / gain))
    if not by_strain:
        raise NumericsError(f"no location gave a baseline conductance: {why}")
    strain = max(by_strain, key=lambda level: (len(by_strain[level]), level))
    return tuple(_place(place, values) for place, values in by_strain[strain].items()), strain


def _image_of_head(run: RunObservation, load: LoadObservation) -> np.ndarray:
    """Image of the head at a load's place with a contrast of one, of the sign of the response, (e,)."""
    problem = run.reconstruction.problem
    share = overlap_mm2(load.pressed, problem.mesh.corners_mm) / problem.mesh.areas_mm2
    return np.asarray(load.response.sign * (run.reconstruction.matrix @ (problem.jacobian @ share)))


def scatter_of_presses(places: Sequence[PlaceResponse]) -> float | None:
    """Spread over an even sheet from the scatter of single presses alone, over its mean; None if unknown."""
    mean = float(np.mean([place.response for place in places]))
    try:
        single = pool_deviations([place.responses for place in places]).value
    except NumericsError:
        return None
    return single / mean * float(np.sqrt(np.mean([1 / len(place.responses) for place in places])))


def _place(place: tuple[str, float, float], values: Sequence[tuple[float, float]]) -> PlaceResponse:
    baseline = float(np.mean([baseline_value for baseline_value, _ in values]))
    return PlaceResponse(*place, baseline, tuple(response for _, response in values))
