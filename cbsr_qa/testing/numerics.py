"""Assertions about numerical methods (rates of convergence, adjoints) and about metrics."""

from collections.abc import Callable, Sequence

import numpy as np

from cbsr_qa.analysis.evaluate import ask
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.plugin.interfaces import LoadMetric, RunMetric


def convergence_order(errors: Sequence[float], sizes: Sequence[float]) -> float:
    """Slope of log error against log size, by least squares.

    Parameters
    ----------
    errors, sizes : at least three of each, positive; sizes all different.

    Raises
    ------
    ValueError
        If there is nothing a rate could be read from.
    """
    error, size = np.asarray(errors, dtype=np.float64), np.asarray(sizes, dtype=np.float64)
    if error.shape != size.shape or error.size < 3 or len(np.unique(size)) < error.size:
        raise ValueError(
            f"a rate needs at least three different sizes with one error each, not {sizes} with {errors}"
        )
    if not (np.isfinite(error) & (error > 0) & (size > 0)).all():
        raise ValueError(f"a rate cannot be read from errors {errors} at sizes {sizes}: all must be positive")
    return float(np.polyfit(np.log(size), np.log(error), 1)[0])


def assert_expected_order(
    errors: Sequence[float], sizes: Sequence[float], order: float, tolerance: float = 0.25
) -> None:
    """Assert that errors fall with the size as error ∝ size^order, within a tolerance on the order.

    Raises
    ------
    AssertionError
        With the errors, sizes and the order found. A rate that is too good fails as well: it means that the errors
        are not what they are taken for, or that the expectation should be raised.
    """
    measured = convergence_order(errors, sizes)
    if abs(measured - order) > tolerance:
        rows = "\n".join(f"  size {size:.4g}: error {error:.4g}" for size, error in zip(sizes, errors, strict=True))
        raise AssertionError(f"order {measured:.3f} instead of {order} ± {tolerance}\n{rows}")


def assert_adjoint(
    forward: Callable[[Array], Array],
    adjoint: Callable[[Array], Array],
    domain_shape: tuple[int, ...],
    range_shape: tuple[int, ...],
    *,
    seed: int = 0,
    tolerance: float = 1e-12,
) -> None:
    """Assert ⟨A x, y⟩ = ⟨x, A* y⟩ for random x and y (the dot-product test, Claerbout 1992).

    Parameters
    ----------
    forward, adjoint : A and A*.
    domain_shape, range_shape : of x and y.
    tolerance : relative to ‖A x‖ ‖y‖ + ‖x‖ ‖A* y‖.
    """
    random = np.random.default_rng(seed)
    x, y = random.standard_normal(domain_shape), random.standard_normal(range_shape)
    image, back = forward(x), adjoint(y)
    if image.shape != range_shape or back.shape != domain_shape:
        raise AssertionError(
            f"the maps give shapes {image.shape} and {back.shape}, not {range_shape}, {domain_shape}"
        )
    difference = abs(float(np.vdot(image, y)) - float(np.vdot(x, back)))
    norm = np.linalg.norm
    scale = float(norm(image.ravel()) * norm(y.ravel()) + norm(x.ravel()) * norm(back.ravel()))
    if not difference <= tolerance * scale:
        raise AssertionError(f"⟨Ax, y⟩ and ⟨x, A*y⟩ differ by {difference:.3g}, relative {difference / scale:.3g}")


def check_metric(metric: LoadMetric | RunMetric, observation: RunObservation) -> list[Measurement]:
    """Measure as in a run, and compare with the declared ``measures``.

    Returns
    -------
    The measurements as a run would store them.

    Raises
    ------
    PluginError
        If an answer could not be stored; names measurement and field.
    AssertionError
        If a measurement has an undeclared name or unit.
    """
    assert isinstance(metric, LoadMetric | RunMetric), "a metric has measure_load or measure_run"
    taken = ask(metric, observation)
    units = getattr(metric, "measures", None)
    assert units is not None, "a metric has `measures`: names of its measurements and their units"
    for value in taken:
        assert units.get(value.name) == value.unit, f"{value.name} in {value.unit} is not among {units}"
    return taken
