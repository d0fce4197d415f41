"""Agreement of relaxations: whole image and blobs, sheet and material strip."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.force import RunForce, run_force
from cbsr_qa.analysis.run.force_kernels import frames_of
from cbsr_qa.calibration.fits.agreement import (
    MeasuredRelaxation,
    RelaxationAgreement,
    compare_relaxations,
    refuse_comparison,
)
from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.calibration.fits.kernel_curve import KernelCurve
from cbsr_qa.calibration.fits.settling import relaxation_start
from cbsr_qa.domain.results.observation import LoadObservation, RelaxationObservation, RunObservation
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.domain.sensor.sensor_type import StripRelaxation

#: Fewest points of a trace that are fitted.
_MIN_POINTS: Final = 5


@dataclass(frozen=True, slots=True, eq=False)
class DirectedAgreement:
    """Two relaxations of one direction.

    Parameters
    ----------
    loading : whether loads are compared after presses; else after releases.
    first, second : names of the compared traces.
    loads : number behind the second.
    found : the comparison.
    """

    loading: bool
    first: str
    second: str
    loads: int
    found: RelaxationAgreement

    @property
    def direction(self) -> str:
        """``"loading"`` or ``"unloading"``."""
        return "loading" if self.loading else "unloading"


def image_against_blobs(run: RunObservation) -> tuple[DirectedAgreement, ...]:
    """Compare the relaxation of the whole image with the blobs', over all loads with both.

    Returns
    -------
    Loading and unloading, if there are such loads. The result is cached with the run.
    """
    return run.derive(_image_against_blobs)


def _image_against_blobs(run: RunObservation) -> tuple[DirectedAgreement, ...]:
    agreements = []
    for loading in (True, False):
        loads = [
            load
            for load in run.loads
            if all(_find_relaxation(load, signal, loading) for signal in ("conductance", "image"))
        ]
        if loads:
            blobs, image = (_measure_relaxation(loads, signal, loading) for signal in ("conductance", "image"))
            agreement = compare_relaxations(blobs, image, tolerance=run.settings.settling_tolerance)
            agreements.append(DirectedAgreement(loading, "blobs", "whole image", len(loads), agreement))
    return tuple(agreements)


def sheet_against_strip(run: RunObservation) -> tuple[DirectedAgreement, ...]:
    """Compare the relaxation of the sheet's response with a strip of its material.

    The sheet's relaxations are the kernels of a unit step common to all calibration loads: strength at the place of
    the head, by the force model. The strip's come from its material file; after releases, as expected on a sheet with
    holds of the same length.

    Returns
    -------
    Loading and unloading, or the reason why they cannot be compared. The result is cached with the run.
    """
    return run.derive(_sheet_against_strip)


def _sheet_against_strip(run: RunObservation) -> tuple[DirectedAgreement, ...]:
    strip = run.record.material.strip_relaxation
    if strip is None:
        reason = f"material {run.record.material.name} has no strip relaxation; characterise a strip of its batch"
        return tuple(_refuse_agreement(loading, reason) for loading in (True, False))
    force = run_force(run)
    if force.learned is None:
        return tuple(
            _refuse_agreement(loading, f"the sheet has no relaxation: {force.why}") for loading in (True, False)
        )
    model = force.learned.model
    return _compare_with_strip(run, force, strip, model.loading, True), _compare_with_strip(
        run, force, strip, model.unloading, False
    )


def _compare_with_strip(
    run: RunObservation, force: RunForce, strip: StripRelaxation, kernel: RelaxationKernel | None, loading: bool
) -> DirectedAgreement:
    window = _window_s(run, force.used, loading)
    if kernel is None or window is None:
        return _refuse_agreement(loading, "the sheet's loads do not show its relaxation: held too short, or too weak")
    expected = _predict_relaxation(strip, loading, float(np.median([load.hold_s for load in force.used])))
    if expected is None:
        return _refuse_agreement(loading, "the material file has no strip relaxation in this direction")
    agreement = compare_relaxations(
        expected, KernelCurve.from_sheet(kernel, *window), tolerance=run.settings.settling_tolerance
    )
    return DirectedAgreement(loading, "strip", "sheet", kernel.loads, agreement)


def _predict_relaxation(strip: StripRelaxation, loading: bool, hold_s: float) -> KernelCurve | None:
    """Expected relaxation of the sheet; after releases it needs both of the strip's kernels."""
    if strip.loading is None:
        return None
    if loading:
        return KernelCurve.from_press(strip.loading)
    return None if strip.unloading is None else KernelCurve.from_release(strip.loading, strip.unloading, hold_s)


def _window_s(run: RunObservation, loads: Sequence[LoadObservation], loading: bool) -> tuple[float, float] | None:
    """First and last time of the frames of holds, or rests, from the end of their ramp; None without any."""
    ends = []
    for load in loads:
        record = load.record
        start_s, end_s = (
            (record.hold_start_s, record.release_start_s) if loading else (record.unloaded_s, record.rest_end_s)
        )
        frames = frames_of(run, load, start_s, end_s)
        if frames is not None and len(frames) >= _MIN_POINTS:
            ends.append((float(frames.time_s[0]) - start_s, float(frames.time_s[-1]) - start_s))
    if not ends:
        return None
    first_s, last_s = np.median(ends, axis=0).tolist()
    return first_s, last_s


def _refuse_agreement(loading: bool, why: str) -> DirectedAgreement:
    return DirectedAgreement(loading, "strip", "sheet", 0, refuse_comparison(why))


def _measure_relaxation(loads: Sequence[LoadObservation], signal: str, loading: bool) -> MeasuredRelaxation:
    curves = [curve for load in loads if (curve := _find_relaxation(load, signal, loading))]
    starts = [0 if loading else relaxation_start(curve.trace.values) for curve in curves]
    traces = [
        (curve.trace.time_s[start:], curve.trace.values[start:]) for curve, start in zip(curves, starts, strict=True)
    ]
    window_s = max(float(time_s[-1]) for time_s, _ in traces)
    change = None
    if not loading:
        holds = [load.relaxation(signal, loading=True) for load in loads]
        change = float(np.mean([0.0 if hold is None else hold.trace.end_level for hold in holds]))
    start_s = min(float(time_s[0]) for time_s, _ in traces)
    return MeasuredRelaxation(fit_common_relaxation(traces), window_s, change, start_s)


def _find_relaxation(load: LoadObservation, signal: str, loading: bool) -> RelaxationObservation | None:
    """The relaxation of a signal, None if it is too short."""
    relaxation = load.relaxation(signal, loading=loading)
    return None if relaxation is None or len(relaxation.trace.values) < _MIN_POINTS else relaxation
