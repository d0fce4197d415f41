"""Relaxations of one press: blob, whole image and stress, after press and release."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.imaging import Imager
from cbsr_qa.calibration.fits import fit_relaxation, relaxation_start, settling_time
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.domain.readings import FrameBlock, SampleBlock
from cbsr_qa.domain.results import LoadObservation, RelaxationFit, RelaxationObservation, Trace
from cbsr_qa.domain.run import Indenter, LoadRecord

#: Stress samples are averaged into this many points a window: the load cell's 8 Hz over a minute are ten times
#: what a fit of tens of seconds needs, and cost ten times its time.
_STRESS_POINTS = 60


def relaxations_of(
    sign: int,
    imager: Imager,
    settings: AnalysisSettings,
    load: LoadObservation,
    cycle: FrameBlock,
    before: NDArray[np.float64],
    force: SampleBlock | None,
) -> tuple[RelaxationObservation, ...]:
    """Fit every recorded relaxation of one press.

    Parameters
    ----------
    sign : makes a load's conductance change positive.
    load : its main mask says which elements are the blob; without a blob there is no conductance trace.
    cycle : frames from the press to the end of the rest.
    before : (e,) float64, the image just before the press: what earlier loads left, and the traces' baseline.
    force : samples of the whole phase, or None.

    Returns
    -------
    Up to five: conductance and whole image after press and release, stress after the press.
    """
    record, area = load.record, imager.mesh.areas_mm2
    seen: list[RelaxationObservation] = []
    images = sign * (imager.images(cycle) - before)
    view = load.mask(settings.main_mask)
    if view is not None and view.sensed is not None:
        weights = np.zeros(len(area))
        weights[view.sensed.elements] = area[view.sensed.elements]
        blob = Trace("blob conductance change", "1", cycle.time_s, images @ weights / weights.sum())
        seen += _press_and_release("conductance", blob, record, settings)
    whole = Trace("mean conductance change of the image", "1", cycle.time_s, images @ area / area.sum())
    seen += _press_and_release("image", whole, record, settings)
    if force is not None:
        seen += _stress(force, load.indenter, record, settings)
    return tuple(seen)


def _press_and_release(
    signal: str, trace: Trace, record: LoadRecord, settings: AnalysisSettings
) -> list[RelaxationObservation]:
    held = _cut(trace, record.hold_start_s, record.release_start_s)
    released = _cut(trace, record.unloaded_s, record.rest_end_s)
    pressed = _loading(signal, held, settings)
    if len(released.time_s) == 0:
        return [pressed]
    return [pressed, _unloading(signal, released, pressed, settings)]


def _loading(signal: str, trace: Trace, settings: AnalysisSettings) -> RelaxationObservation:
    steady = abs(_end_level(trace))
    fit = _fit(trace, 0, steady, settings)
    settled = settling_time(
        fit,
        window_s=_window_s(trace),
        tolerance=settings.settling_tolerance,
        band=settings.settling_band,
    )
    return RelaxationObservation(signal, True, trace, fit, settled)


def _unloading(
    signal: str, trace: Trace, pressed: RelaxationObservation, settings: AnalysisSettings
) -> RelaxationObservation:
    start = relaxation_start(trace.values)
    loaded = _steady_change(pressed)
    fit = _fit(trace, start, abs(loaded), settings)
    settled = settling_time(
        fit,
        window_s=_window_s(trace),
        tolerance=settings.settling_tolerance,
        band=settings.settling_band,
        loaded_change=loaded,
        start_s=float(trace.time_s[start]) if start else 0.0,
    )
    return RelaxationObservation(signal, False, trace, fit, settled)


def _steady_change(pressed: RelaxationObservation) -> float:
    """Steady change under load: of an accepted fit, else the observed end of the hold."""
    if pressed.settling.value_s is not None and not pressed.settling.censored:
        return pressed.fit.offset
    return _end_level(pressed.trace)


def _fit(trace: Trace, start: int, steady: float, settings: AnalysisSettings) -> RelaxationFit:
    """Fit a trace from a sample on; one that never leaves the settling band of the steady change is flat."""
    return fit_relaxation(
        trace.time_s[start:],
        trace.values[start:],
        r_squared_gate=settings.r_squared_gate,
        flat_within=settings.settling_tolerance * steady,
    )


def _end_level(trace: Trace) -> float:
    return float(np.median(trace.values[-4:])) if len(trace.values) else 0.0


def _stress(
    force: SampleBlock, indenter: Indenter, record: LoadRecord, settings: AnalysisSettings
) -> list[RelaxationObservation]:
    taken = force.between(record.hold_start_s, record.release_start_s)
    if len(taken) < _STRESS_POINTS:
        return []
    points = np.array_split(np.arange(len(taken)), _STRESS_POINTS)
    time_s = np.array([taken.time_s[p].mean() for p in points]) - record.hold_start_s
    stress_kPa = np.array([taken.values[p].mean() for p in points]) / indenter.area_mm2 * 1e3
    return [_loading("stress", Trace("stress", "kPa", time_s, stress_kPa), settings)]


def _cut(trace: Trace, start_s: float, end_s: float) -> Trace:
    inside = (trace.time_s >= start_s) & (trace.time_s < end_s)
    return Trace(trace.name, trace.unit, trace.time_s[inside] - start_s, trace.values[inside])


def _window_s(trace: Trace) -> float:
    """Length of the observed window: half a frame beyond the last frame's middle."""
    if len(trace.time_s) < 2:
        return float(trace.time_s.max(initial=1.0))
    return float(trace.time_s[-1] + np.median(np.diff(trace.time_s)) / 2)
