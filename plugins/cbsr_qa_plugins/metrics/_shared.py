"""What metrics share: labels of what was measured at a load, a number in percent, and a refusal with its reason."""

from collections.abc import Iterator
from typing import Final

from cbsr_qa.calibration.fits.estimates import Estimate
from cbsr_qa.plugin import Bound, LoadObservation, MaskView, Measurement, NumericsError, RunObservation

_NOT_DETECTED: Final = "not detected: no positive element of the image stands above the noise floor"
_MERGED: Final = "not detected by itself: it shares the region of another load held at the same time"
_UNASSIGNED: Final = "not detected: no region lies within a head's diameter of it that is not another load's"


def why_not(view: MaskView) -> str:
    """Say why a load has no region under a mask, and so no spatial metric a value."""
    if not view.regions:
        return _NOT_DETECTED
    return _MERGED if view.fate == "merged" else _UNASSIGNED


def masks_of(load: LoadObservation, run: RunObservation) -> Iterator[tuple[MaskView, str]]:
    """Yield each mask of a load with its qualifier: empty for the main one, ``"mask 25 %"`` for another."""
    for view in load.masks:
        yield view, run.mask_qualifier(view.fraction)


def measurement_of_load(
    load: LoadObservation,
    name: str,
    value: float | None,
    unit: str,
    *,
    uncertainty: float | None = None,
    qualifier: str = "",
    how: str = "",
    bound: Bound = Bound.EXACT,
) -> Measurement:
    """Make a measurement of one load, which names the load by its index within its phase."""
    place = load.record.load
    return Measurement(
        name,
        value,
        unit,
        uncertainty=uncertainty,
        phase=load.phase,
        location=place.label,
        trial=place.trial,
        qualifier=qualifier,
        how=how,
        bound=bound,
        load=load.record.index,
        strain=place.strain,
    )


def percent(name: str, estimate: Estimate, how: str, *, qualifier: str = "", location: str = "") -> Measurement:
    """Make a measurement in percent of an estimate that is a fraction."""
    stderr = None if estimate.stderr is None else 100 * estimate.stderr
    return Measurement(
        name, 100 * estimate.value, "%", uncertainty=stderr, qualifier=qualifier, location=location, how=how
    )


def refuse_measurement(name: str, unit: str, error: NumericsError, *, qualifier: str = "") -> Measurement:
    """Make a measurement without a value that says why, and what would help."""
    how = f"{error.reason}; {error.remedy}" if error.remedy else error.reason
    return Measurement(name, None, unit, qualifier=qualifier, how=how)


def format_count(count: int, singular: str, many: str = "") -> str:
    """Write a count with its noun: ``1 press``, ``3 presses``."""
    return f"{count} {singular if count == 1 else many or f'{singular}s'}"
