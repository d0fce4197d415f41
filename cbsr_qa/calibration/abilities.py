"""What a calibrated sensor does, in numbers and in sentences that claim no more than its calibration carries."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from cbsr_qa.calibration.force.inverse import ForceInverse, least_force_N, map_tables
from cbsr_qa.calibration.force.shared_error import SharedError
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.calibration.force.validity import batch_words
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import StandardRole, describe_force_error, find_standard
from cbsr_qa.domain.results.calibration import Calibration, ForceModel, SettlingSummary

#: Half of a normal interval of 95 %, in standard errors.
_NORMAL_95: Final = 1.959964


@dataclass(frozen=True, slots=True, eq=False)
class ForceAbility:
    """What a force model does at the places where its head may be.

    Parameters
    ----------
    places_mm : (n, 2) nodes of the model's lattice within the calibrated radius; all that the head fits if none is.
    least_N : (n,) force whose change in one frame just counts as a load.
    """

    places_mm: Array
    least_N: Array
    _inverse: ForceInverse
    _template_size: Array
    _shared: SharedError

    @classmethod
    def from_calibration(cls, calibration: Calibration, model: ForceModel) -> Self:
        matched_filter, node = TemplateFilter(model), model.node.ravel()
        lattice_mm = model.lattice.places_mm()
        fits_mask = np.where(node >= 0, model.fits[node], False)
        fits_mask &= np.isfinite(matched_filter.template(lattice_mm)).all(axis=1)
        near_mask = fits_mask & (np.hypot(*lattice_mm.T) <= calibration.validity.radius_mm)
        places_mm = lattice_mm[near_mask if near_mask.any() else fits_mask]
        inverse = ForceInverse(model, calibration.against_stress, calibration.indenter.area_mm2, map_tables(model))
        size = np.linalg.norm(matched_filter.template(places_mm), axis=1)
        shared = SharedError(calibration.standards)
        return cls(places_mm, least_force_N(inverse, size, places_mm), inverse, size, shared)

    def stderr_N(self, force_N: float) -> Array:
        """Return the standard error (n,) of a force at each known place, from one frame."""
        places_mm, size = self.places_mm, self._template_size
        covariance = np.zeros((len(size), 3, 3))
        covariance[:, 0, 0] = 1 / size**2
        strength = self._inverse.strength(np.full(len(size), force_N), places_mm)
        _, stderr_N = self._inverse.force(Matches(places_mm, strength, covariance, strength, strength))
        return np.hypot(stderr_N, self._shared.stderr_N(np.array([force_N])))


def describe_abilities(calibration: Calibration) -> Iterator[str]:
    """Yield what the sensor reads and how well, how fast it settles, and what limits its use."""
    yield from _describe_force(calibration)
    if calibration.force is not None and calibration.force.batch is not None:
        words = batch_words(calibration.force.batch)
        yield f"{words[0].upper()}{words[1:]}."
    yield from _describe_settling(calibration)
    if calibration.place is not None:
        yield "Places are learned from the run's own presses."
    if calibration.validity.temperature_C is None:
        yield "Temperature was not measured; errors from temperature changes are not included."


def _describe_force(calibration: Calibration) -> Iterator[str]:
    validity = calibration.validity
    where = f"a head of {calibration.indenter.words()} within {validity.radius_mm:.3g} mm of the centre"
    if calibration.force is None:
        yield f"Reads no force: {calibration.no_force}."
        return
    ability = ForceAbility.from_calibration(calibration, calibration.force)
    x_mm, y_mm = ability.places_mm[np.argmax(ability.least_N)]
    centre_N = ability.least_N[np.argmin(np.hypot(*ability.places_mm.T))]
    least = f"One frame detects {centre_N:.2g} N at the centre, {ability.least_N.max():.2g} N at the worst place"
    if validity.force_N is None:
        yield f"Reads the force of {where}; its range was not measured."
    else:
        low_N, high_N = validity.force_N
        forces_N = (low_N,) if low_N == high_N else (low_N, high_N)
        errors = " and ".join(
            f"± {_NORMAL_95 * np.sqrt(np.mean(ability.stderr_N(force_N) ** 2)):.2g} N at {force_N:.3g} N"
            for force_N in forces_N
        )
        reads = " to ".join(f"{force_N:.3g}" for force_N in forces_N)
        unstated = (
            " They take the intercept of the material's characteristic as exact: it is stated without uncertainty."
        )
        exact = "" if calibration.against_stress.intercept.stderr else unstated
        worst_N = _NORMAL_95 * ability.stderr_N(high_N).max()
        yield (
            f"Reads {reads} N of {where}: {errors} (95 %, root mean square over these places; at most"
            f" ± {worst_N:.2g} N), for one settled load at a known place. These errors"
            f" include {describe_force_error(calibration.standards)}.{exact}"
        )
        if find_standard(calibration.standards, StandardRole.LOAD_CELL) is not None:
            yield from _describe_expanded(calibration)
    yield f"{least}, ({x_mm:z.3g}, {y_mm:z.3g}) mm.".replace("-", "−")


def _describe_expanded(calibration: Calibration) -> Iterator[str]:
    """Yield the expanded uncertainty; without a load cell's certificate the newton itself comes from nowhere."""
    # needed only where a certificate is stated
    from cbsr_qa.calibration.uncertainty.budget import evaluate_forces
    from cbsr_qa.domain.results.expanded_force import Result

    try:
        on_the_day, in_use = (
            evaluate_forces(calibration, result=when) for when in (Result.ON_THE_DAY, Result.IN_USE)
        )
    except CalibrationError as error:
        yield f"No expanded uncertainty is stated: {error.reason}."
        return
    for force_N in dict.fromkeys(one.force_N for one in on_the_day):
        day, use = (
            max((one for one in expanded if one.force_N == force_N), key=lambda one: one.U_N)
            for expanded in (on_the_day, in_use)
        )
        x_mm, y_mm = day.place_mm
        yield (
            f"Expanded uncertainty of {force_N:.3g} N: at most U = {day.U_N:#.2g} N (k = {day.k:.2f}, 95 %) on the"
            f" day of calibration, at ({x_mm:z.3g}, {y_mm:z.3g}) mm, mostly by {day.components[0].name}; in use"
            f" {use.U_N:#.2g} N (k = {use.k:.2f}), mostly by {use.components[0].name}."
        ).replace("-", "−")
    yield (
        "The ± above is 1.96 standard errors as the sensor states them of a frame; U adds the other inputs that are"
        " stated, and k allows for their degrees of freedom."
    )
    without = (
        f"{name} {', '.join(one[0].not_stated)}" for name, one in (("U without:", on_the_day), ("in use:", in_use))
    )
    yield f"{'; '.join(without)}."


def _describe_settling(calibration: Calibration) -> Iterator[str]:
    means = {s.loading: s for s in calibration.settling if s.signal == "conductance" and s.mean_s is not None}
    if not means:
        yield "No settling time was determined."
        return
    words = [
        f"{_format_settling(means[loading])} {after}"
        for loading, after in ((True, "after a press"), (False, "after a release"))
        if loading in means
    ]
    yield f"Settles in {' and '.join(words)} (mean over its loads)."


def _format_settling(summary: SettlingSummary) -> str:
    return f"{'at least ' if summary.censored else ''}{summary.mean_s:.3g} s"
