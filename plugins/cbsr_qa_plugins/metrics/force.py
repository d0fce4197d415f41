"""How well a sensor tells force: held-out loads, map, detection limit."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import ClassVar, Final

import numpy as np

from cbsr_qa.analysis.run.force import HELD_OUT, TRIAL_LEFT_OUT, ForceTest, RunForce, run_force
from cbsr_qa.analysis.run.force_quality import (
    ForceErrors,
    calibration_radius_mm,
    detectable_forces,
    errors_of,
    gauge_factor,
    global_errors,
    map_quality,
    places_mm,
    tests_of,
)
from cbsr_qa.calibration.fits.estimates import Estimate
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.plugin import CbsrError, Measurement, RunObservation

KNOWN: Final = "place known"
ESTIMATED: Final = "place estimated"
CENTRE: Final = "centre"
WORST: Final = "worst place"
SHEET: Final = "sheet"
#: Standard errors either way, and the share of a normal distribution within them.
_LEVELS: Final = (("force_coverage_68", 1.0, 0.6827), ("force_coverage_95", 1.96, 0.95))


class ForceError:
    """``force_error_sd`` and ``force_error_bias`` [N] over loads the sensor's force was not learned from.

    Qualifiers say whether the place was given (``place known``) or found from the same readings (``place
    estimated``); with ``, trial left out`` added the loads are those of each trial of the calibration in turn, else
    those held out (of phases that press all over the sheet, where a run has any). ``force_error_global_sd`` [N] is
    the same with one response for the whole sheet (paper: one ρ̄₀). ``force_coverage_68`` and ``force_coverage_95``
    [%]: held-out loads within the stated intervals, from 30 loads on.

    ``response_uniformity`` [%]: spread of the sheet's response over the calibrated area; ``response_uncertainty``
    [%]: root mean square standard error of the map there. ``minimum_detectable_force`` [N] of one frame at the
    ``centre`` and the ``worst place`` of that area. ``gauge_factor`` [1] of the ``sheet``: mean over the sheet of its
    local change per strain, at steady state. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {
        "force_error_sd": "N",
        "force_error_bias": "N",
        "force_error_global_sd": "N",
        "force_coverage_68": "%",
        "force_coverage_95": "%",
        "response_uniformity": "%",
        "response_uncertainty": "%",
        "minimum_detectable_force": "N",
        "gauge_factor": "1",
    }
    needs_force: ClassVar[bool] = True  # it is asked last: a helper learns the force meanwhile

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; without a force model nothing has a value, and ``how`` says why."""
        force = run_force(run)
        if force.learned is None:
            return tuple(_missing_measurement(name, qualifier, force.why) for name, qualifier in _everything())
        return (
            *_errors(tests_of(run, force, HELD_OUT), "", "no load was held out: every phase calibrates"),
            *_errors(
                tests_of(run, force, TRIAL_LEFT_OUT),
                f", {TRIAL_LEFT_OUT}",
                "no place of the calibration was pressed in two trials",
            ),
            *_map(force, force.learned),
            *_detectable(run, force, force.learned),
            _gauge(run, force),
        )


def _everything() -> Iterator[tuple[str, str]]:
    for name in ForceError.measures:
        if name == "minimum_detectable_force":
            yield from ((name, CENTRE), (name, WORST))
        elif name == "gauge_factor":
            yield name, SHEET
        elif name == "force_error_global_sd":
            yield name, KNOWN
        elif name.startswith("force_"):
            yield from ((name, KNOWN), (name, ESTIMATED))
        else:
            yield name, ""


def _errors(tests: tuple[ForceTest, ...], after: str, none: str) -> Iterator[Measurement]:
    if after and not tests:
        yield _missing_measurement("force_error_sd", f"{KNOWN}{after}", none)  # reported once
        return
    for qualifier, errors in (
        (f"{KNOWN}{after}", errors_of(tests, known=True)),
        (f"{ESTIMATED}{after}", errors_of(tests, known=False)),
    ):
        how = _describe_tests(errors) if tests else none
        yield _measure_estimate("force_error_sd", qualifier, errors.deviation, how, none=not tests)
        yield _measure_estimate("force_error_bias", qualifier, errors.bias, how, none=not tests)
        for name, reach, nominal in _LEVELS if not after else ():
            words = f"{how}; ± is what chance gives an honest interval of as many"
            share = partial(errors.coverage, reach, nominal)
            yield _measure_estimate(name, qualifier, share, words, 100.0, none=not tests)
    flat = global_errors(tests)
    how = (
        f"{_describe_tests(flat)}; one response for the whole sheet, the mean of the calibration's loads"
        if tests
        else none
    )
    yield _measure_estimate("force_error_global_sd", f"{KNOWN}{after}", flat.deviation, how, none=not tests)


def _describe_tests(errors: ForceErrors) -> str:
    phases = list(dict.fromkeys(test.load.phase for test in errors.tests))
    missed = f", {errors.missed} not detected" if errors.missed else ""
    forces = [test.measured_N for test in errors.tests]
    over = f", {min(forces):.2g} to {max(forces):.2g} N" if forces else ""
    return f"{len(errors.tests)} loads of {', '.join(phases) or 'no phase'}{missed}{over}"


def _map(force: RunForce, learned: LearnedForce) -> Iterator[Measurement]:
    radius_mm = calibration_radius_mm(force)
    quality = map_quality(learned, radius_mm)
    used = [load for load, why in zip(force.used, learned.refused, strict=True) if not why]
    places = len(np.unique(places_mm(used), axis=0))
    how = f"within {radius_mm:.1f} mm of the centre, from {len(used)} loads at {places} places"
    # As of one value a place; of one place nothing is known.
    stderr = quality.spread / (2 * (places - 1)) ** 0.5 if places > 1 else None
    error = None if stderr is None else 100 * stderr
    yield Measurement("response_uniformity", 100 * quality.spread, "%", error, how=f"spread of the map {how}")
    x_mm, y_mm = quality.least_sure_mm
    where = f"most, {100 * quality.stderr.max():.2g} %, at ({x_mm:.0f}, {y_mm:.0f}) mm".replace("-", "−")
    yield Measurement("response_uncertainty", 100 * quality.rms_error, "%", how=f"root mean square {how}; {where}")


def _detectable(run: RunObservation, force: RunForce, learned: LearnedForce) -> Iterator[Measurement]:
    name = "minimum_detectable_force"
    quality = map_quality(learned, calibration_radius_mm(force))
    try:
        forces = detectable_forces(learned, run.record.indenter, np.vstack([[0.0, 0.0], quality.places_mm]))
    except CbsrError as error:
        yield from (_missing_measurement(name, qualifier, error.reason) for qualifier in (CENTRE, WORST))
        return
    for qualifier, least in ((CENTRE, forces[0]), (WORST, max(forces, key=lambda limit: limit.force_N))):
        x_mm, y_mm = least.place_mm
        how = f"one frame at ({x_mm:.0f}, {y_mm:.0f}) mm, at {learned.model.threshold:.2g} times its noise"
        how = f"{how}: found in half of all frames, noise in one of 10 000".replace("-", "−")
        yield Measurement(name, least.force_N, "N", least.stderr_N or None, qualifier=qualifier, how=how)


def _gauge(run: RunObservation, force: RunForce) -> Measurement:
    try:
        value, share = gauge_factor(run, force)
    except CbsrError as error:
        return _missing_measurement("gauge_factor", SHEET, error.reason)
    how = (
        "mean over the sheet of contrast under the head against nominal strain; steady state"
        f" {share.value:.3f} of the end of the hold, by the relaxation all loads share"
    )
    return Measurement("gauge_factor", value.value, "1", value.stderr, qualifier=SHEET, how=how)


def _measure_estimate(
    name: str, qualifier: str, estimate: Callable[[], Estimate], how: str, factor: float = 1.0, *, none: bool
) -> Measurement:
    """Make a measurement of an estimate, or give the reason for its absence."""
    if none:
        return _missing_measurement(name, qualifier, how)
    try:
        value = estimate()
    except CbsrError as error:
        return _missing_measurement(name, qualifier, error.reason)
    stderr = None if value.stderr is None else factor * value.stderr
    unit = ForceError.measures[name]
    return Measurement(name, factor * value.value, unit, stderr, qualifier=qualifier, how=how)


def _missing_measurement(name: str, qualifier: str, why: str) -> Measurement:
    return Measurement(name, None, ForceError.measures[name], qualifier=qualifier, how=why)
