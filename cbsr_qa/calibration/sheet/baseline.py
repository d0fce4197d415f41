"""Apparent baseline conductance ρ̄₀ per location, and reasons why a load may not determine it (paper Eq 7)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.domain.imaging import Blob
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import BaselineConductance
from cbsr_qa.domain.results.observation import LoadObservation
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic, Response

#: The predicted relative change must be this many of its own standard errors from zero.
_MIN_STDERRS: Final = 3.0
#: Qualifier of a value by whether its load was settled; None if no settling time is known.
_REMARKS: Final = {
    True: "",
    False: "taken before 1.5 settling times",
    None: "taken at the end of the hold: no settling time is known",
}


@dataclass(frozen=True, slots=True)
class LoadBaseline:
    """ρ₀ from one load.

    Parameters
    ----------
    value, stderr : relative image units; None for the reason ``why``.
    """

    value: float | None
    stderr: float | None
    why: str = ""


def measure_sensed_change(values: Array, blob: Blob, response: Response) -> Array:
    """Area-weighted mean signed change (…) of images (…, e) over a blob, noise floor *not* subtracted."""
    areas = blob.image.mesh.areas_mm2[blob.elements]
    return np.asarray(response.sign * (values[..., blob.elements] @ areas) / areas.sum())


def load_baseline(
    load: LoadObservation, against_stress: QuasiStatic, noise_images: Array, main_mask: float
) -> LoadBaseline:
    """ρ₀ = Δρ / (α_σ σ + β_σ) of one load.

    Δρ is the mean over the sensed blob of the steady image. Its standard error is the scatter of the same mean over
    the noise images, with that of the force; the errors of α and β are common to all loads and not included.

    Parameters
    ----------
    against_stress : α_σ [1/kPa] and β_σ.
    noise_images : (k, e) unloaded images.
    main_mask : fraction of the mask whose blob is the sensed region.
    """
    view = load.mask(main_mask)
    if view is None or view.sensed is None:
        return LoadBaseline(None, None, "no blob was sensed")
    stress_kPa = load.stress_kPa
    if stress_kPa is None:
        return LoadBaseline(None, None, load.no_force or "no force was recorded")
    predicted, why_not = _predict_signed(against_stress, stress_kPa, load.response)
    if why_not:
        return LoadBaseline(None, None, why_not)
    change = float(measure_sensed_change(load.image.values, view.sensed, load.response))
    if change <= 0:
        return LoadBaseline(None, None, f"the sensed change {change:.3g} does not have the sign of the response")
    value = change / predicted
    noise = measure_sensed_change(noise_images, view.sensed, load.response)
    change_error = float(np.sqrt(np.mean(noise**2) / max(load.steady_frames, 1))) / change
    stress_error = 0.0
    if load.force_stderr_N is not None:
        stress_error = (
            abs(against_stress.slope.value) * load.force_stderr_N / load.indenter.area_mm2 * 1e3 / predicted
        )
    return LoadBaseline(value, value * float(np.hypot(change_error, stress_error)), _REMARKS[load.settled])


def predict_change(against_stress: QuasiStatic, stress_kPa: float) -> tuple[float, float]:
    """Relative change α_σ σ + β_σ and its standard error; an unstated error counts as zero."""
    predicted = against_stress.slope.value * stress_kPa + against_stress.intercept.value
    return predicted, float(np.sqrt(against_stress.variance(np.array(stress_kPa))))


def location_baseline(location: str, x_mm: float, y_mm: float, loads: Sequence[LoadBaseline]) -> BaselineConductance:
    """Mean over the loads of one location, with the larger of their scatter and their own errors."""
    values_and_errors = [
        (load.value, load.stderr) for load in loads if load.value is not None and load.stderr is not None
    ]
    remarks = "; ".join(dict.fromkeys(load.why for load in loads if load.why))
    if not values_and_errors:
        return BaselineConductance(location, x_mm, y_mm, None, None, 0, remarks or "no load was pressed here")
    values, errors = np.array(values_and_errors).T
    own_stderr = float(np.sqrt((errors**2).sum())) / len(values)
    scatter = float(values.std(ddof=1)) / np.sqrt(len(values)) if len(values) > 1 else 0.0
    return BaselineConductance(
        location, x_mm, y_mm, float(values.mean()), max(own_stderr, float(scatter)), len(values), remarks
    )


def baseline_conductance(
    loads: Sequence[LoadObservation],
    against_stress: QuasiStatic,
    noise_images: Array,
    main_mask: float,
) -> tuple[BaselineConductance, ...]:
    """ρ̄₀ of every location of some loads, in the order of their first press."""
    places: dict[tuple[str, float, float], list[LoadBaseline]] = {}
    for load in loads:
        place = load.record.load
        baseline = load_baseline(load, against_stress, noise_images, main_mask)
        places.setdefault((place.label, place.x_mm, place.y_mm), []).append(baseline)
    return tuple(location_baseline(*place, baseline) for place, baseline in places.items())


def _predict_signed(against_stress: QuasiStatic, stress_kPa: float, response: Response) -> tuple[float, str]:
    """Predicted change in the direction of the response, and why it is unusable; empty if it is usable."""
    predicted, error = predict_change(against_stress, stress_kPa)
    prediction = f"α σ + β = {predicted:.3g} ± {error:.2g} at {stress_kPa:.3g} kPa"
    if predicted == 0 or abs(predicted) < _MIN_STDERRS * error:
        return 0.0, f"{prediction} is not clear of zero"
    signed = response.sign * predicted
    if signed < 0:
        expected, decided = ("less", "more") if predicted < 0 else ("more", "less")
        return (
            0.0,
            f"{prediction} makes pressed places conduct {expected}; the response of this run is that they do"
            f" {decided}",
        )
    return signed, ""
