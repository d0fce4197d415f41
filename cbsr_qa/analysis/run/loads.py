"""Analysis of one press: steady image, blobs, force, relaxations."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cbsr_qa.analysis.defects.load_cell import describe_cell_limit
from cbsr_qa.analysis.run.imaging import Imager, mask_views, mean_under
from cbsr_qa.calibration.fits.relaxation import fit_relaxation
from cbsr_qa.calibration.fits.settling import relaxation_start, settling_time, window_s
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import Footprint
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import Indenter, LoadRecord
from cbsr_qa.domain.results.observation import LoadObservation, RelaxationObservation, RunObservation, Trace
from cbsr_qa.domain.run.run import PhaseRecord
from cbsr_qa.domain.sensor.sensor_type import Response

#: Stress samples are averaged into this many points per window: the load cell's 8 Hz over a minute are ten times what
#: a fit over tens of seconds needs, at ten times the cost.
_STRESS_POINTS: Final = 60


@dataclass(frozen=True, slots=True, eq=False)
class LoadWindow:
    """Frames of one press.

    Parameters
    ----------
    before : last frames of the unloaded sheet before the head starts down (may be empty).
    cycle : every frame from the press to the end of the rest.
    steady : the last frames of the hold, at least one.
    """

    before: FrameBlock
    cycle: FrameBlock
    steady: FrameBlock


@dataclass(frozen=True, slots=True)
class LoadSetting:
    """Settings shared by the analysis of all loads of a run."""

    imager: Imager
    settings: AnalysisSettings
    indenter: Indenter
    noise_floor: float
    response: Response


def load_window(phase: PhaseRecord, record: LoadRecord, settings: AnalysisSettings) -> LoadWindow:
    """Cut the frames of one press out of its phase; NumericsError if the hold has none."""
    frames = phase.frames
    hold = None if frames is None else frames.select_interval(record.hold_start_s, record.release_start_s)
    if frames is None or hold is None or not len(hold):
        raise NumericsError(f"load {record.load.label} of phase {phase.name!r} was held without taking a frame")
    frames_before = frames.select_interval(_free_from_s(phase, record), record.press_start_s)
    return LoadWindow(
        frames_before.select(slice(max(len(frames_before) - settings.reference_frames, 0), None)),
        frames.select_interval(record.press_start_s, record.rest_end_s),
        hold.select(slice(max(len(hold) - settings.steady_frames, 0), None)),
    )


def window_of(run: RunObservation, load: LoadObservation) -> LoadWindow:
    """Return the frames of one press of an observed run; NumericsError if the hold has none."""
    return load_window(run.record.phase(load.phase), load.record, run.settings)


def _free_from_s(phase: PhaseRecord, record: LoadRecord) -> float:
    """Time when the previous press had left the sheet: after a short rest few frames are unloaded."""
    loads_and_loops = (*phase.loads, *phase.loops)
    return max(
        (earlier.release_end_s for earlier in loads_and_loops if earlier.release_end_s <= record.press_start_s),
        default=phase.started_s,
    )


def mean_change_under_head(setting: LoadSetting, record: LoadRecord, window: LoadWindow) -> float:
    """Mean relative change under the head in the steady frames, unsigned, used to vote on the response."""
    values = setting.imager.images(window.steady).mean(axis=0)
    pressed = setting.indenter.footprint_at(record.load.x_mm, record.load.y_mm)
    return mean_under(setting.imager.mesh, values, pressed)


def observe_load(setting: LoadSetting, phase: PhaseRecord, record: LoadRecord, window: LoadWindow) -> LoadObservation:
    """Analyse one press, also relative to the other reference if residues of earlier loads exceed the noise floor."""
    imager, image_before = setting.imager, _image_before(setting, window)
    residue = float(np.abs(image_before).max())
    absolute = imager.images(window.steady).mean(axis=0)
    values = {"run": absolute, "load": absolute - image_before}
    reference = setting.settings.reference
    other_reference = "load" if reference == "run" else "run"
    load = _observe(setting, phase, record, window, values[reference], residue)
    if residue <= setting.noise_floor:
        return load
    return replace(load, alternate=_observe(setting, phase, record, window, values[other_reference], residue))


def add_relaxations(
    load: LoadObservation,
    window: LoadWindow,
    relaxations: tuple[RelaxationObservation, ...],
    settings: AnalysisSettings,
) -> LoadObservation:
    """Return an observed press with its relaxations and whether its steady frames had settled."""
    load = replace(load, relaxations=relaxations)
    return replace(load, settled=_is_settled(load, window, settings))


def _image_before(setting: LoadSetting, window: LoadWindow) -> Array:
    """Image (e,) just before the press: residues of earlier loads."""
    imager = setting.imager
    return imager.images(window.before).mean(axis=0) if len(window.before) else np.zeros(len(imager.mesh.elements))


def _observe(
    setting: LoadSetting,
    phase: PhaseRecord,
    record: LoadRecord,
    window: LoadWindow,
    values: Array,
    residue: float,
) -> LoadObservation:
    no_force = describe_cell_limit(phase.channel("force"), record)
    force, stderr = (None, None) if no_force else mean_force(phase.channel("force"), window.steady, record)
    mesh, footprint = setting.imager.mesh, setting.indenter.footprint_at(record.load.x_mm, record.load.y_mm)
    neighbours = list_neighbours(setting.indenter, phase, record, float(window.steady.time_s[-1]))
    signed = setting.response.sign * values
    return LoadObservation(
        phase=phase.name,
        record=record,
        indenter=setting.indenter,
        image=Image(mesh, values),
        response=setting.response,
        noise_floor=setting.noise_floor,
        masks=mask_views(mesh, signed, setting.noise_floor, setting.settings, footprint, neighbours),
        steady_frames=len(window.steady),
        settled=None,
        force_N=force,
        force_stderr_N=stderr,
        residue=residue,
        together=1 + len(neighbours),
        no_force=no_force,
    )


def list_neighbours(indenter: Indenter, phase: PhaseRecord, record: LoadRecord, time_s: float) -> list[Footprint]:
    """Other places of a phase that loads several at a time."""
    return [
        indenter.footprint_at(other.load.x_mm, other.load.y_mm)
        for other in phase.loads
        if other.index != record.index and other.hold_start_s <= time_s < other.release_start_s
    ]


def mean_force(
    samples: SampleBlock | None, steady: FrameBlock, record: LoadRecord
) -> tuple[float | None, float | None]:
    """Return the load cell's mean over the steady frames, and its standard error [N]; None without samples."""
    held_N = select_forces(samples, steady, record)
    if not len(held_N):
        return None, None
    spread = float(np.std(held_N, ddof=1)) if len(held_N) > 1 else 0.0
    return float(held_N.mean()), spread / len(held_N) ** 0.5


def select_forces(samples: SampleBlock | None, steady: FrameBlock, record: LoadRecord) -> Array:
    """Return the load cell's samples (n,) over the steady frames of a press, to the end of its hold [N]."""
    if samples is None:
        return np.zeros(0)
    half_frame = float(np.median(np.diff(steady.time_s))) / 2 if len(steady) > 1 else 0.0
    return samples.select_interval(float(steady.time_s[0]) - half_frame, record.release_start_s).values


def _is_settled(load: LoadObservation, window: LoadWindow, settings: AnalysisSettings) -> bool | None:
    """Whether the steady frames lie beyond the required multiple of the load's own settling time; None if unknown."""
    press_relaxation = load.relaxation("conductance", loading=True)
    if press_relaxation is None or press_relaxation.settling.value_s is None:
        return None
    needed_s = settings.settling_multiple * press_relaxation.settling.value_s
    held_s = float(window.steady.time_s[0]) - load.record.hold_start_s
    return not press_relaxation.settling.censored and held_s >= needed_s


def relaxations_of(
    setting: LoadSetting, phase: PhaseRecord, load: LoadObservation, window: LoadWindow
) -> tuple[RelaxationObservation, ...]:
    """Fit the relaxations of one press: up to two of the blob, two of the whole image, and that of the stress.

    Parameters
    ----------
    load : load whose main mask gives the blob's elements; without a blob there is no conductance trace.
    """
    record, settings, area = load.record, setting.settings, setting.imager.mesh.areas_mm2
    cycle, force = window.cycle, phase.channel("force")
    relaxations: list[RelaxationObservation] = []
    images = setting.response.sign * (setting.imager.images(cycle) - _image_before(setting, window))
    view = load.mask(settings.main_mask)
    if view is not None and view.sensed is not None:
        weights = np.zeros(len(area))
        weights[view.sensed.elements] = area[view.sensed.elements]
        blob = Trace("blob conductance change", "1", cycle.time_s, images @ weights / weights.sum())
        relaxations += _press_and_release("conductance", blob, record, settings)
    whole_trace = Trace("mean conductance change of the image", "1", cycle.time_s, images @ area / area.sum())
    relaxations += _press_and_release("image", whole_trace, record, settings)
    if force is not None:
        relaxations += _stress(force, load.indenter, record, settings)
    return tuple(relaxations)


def _press_and_release(
    signal: str, trace: Trace, record: LoadRecord, settings: AnalysisSettings
) -> list[RelaxationObservation]:
    held_trace = _cut(trace, record.hold_start_s, record.release_start_s)
    released_trace = _cut(trace, record.unloaded_s, record.rest_end_s)
    press_fit = _fit_trace(signal, held_trace, settings, loaded_change=None, steady=held_trace.end_level)
    if len(released_trace.time_s) == 0:
        return [press_fit]
    # The steady change under load is that of an accepted fit, else the observed end of the hold.
    has_settled = press_fit.settling.value_s is not None and not press_fit.settling.censored
    steady_change = press_fit.fit.offset if has_settled else press_fit.trace.end_level
    start = relaxation_start(released_trace.values)
    return [
        press_fit,
        _fit_trace(signal, released_trace, settings, loaded_change=steady_change, steady=steady_change, start=start),
    ]


def _fit_trace(
    signal: str,
    trace: Trace,
    settings: AnalysisSettings,
    *,
    loaded_change: float | None,
    steady: float,
    start: int = 0,
) -> RelaxationObservation:
    """Fit a trace from a sample on; one that never leaves the settling band of the steady change is flat.

    Parameters
    ----------
    loaded_change : change under load before a release; None after a press.
    """
    fit = fit_relaxation(
        trace.time_s[start:],
        trace.values[start:],
        r_squared_gate=settings.r_squared_gate,
        flat_within=settings.settling_tolerance * abs(steady),
    )
    settling = settling_time(
        fit,
        window_s=window_s(trace.time_s),
        tolerance=settings.settling_tolerance,
        band=settings.settling_band,
        loaded_change=loaded_change,
        start_s=float(trace.time_s[start]) if start else 0.0,
    )
    return RelaxationObservation(signal, loaded_change is None, trace, fit, settling)


def _stress(
    force: SampleBlock, indenter: Indenter, record: LoadRecord, settings: AnalysisSettings
) -> list[RelaxationObservation]:
    held_samples = force.select_interval(record.hold_start_s, record.release_start_s)
    if len(held_samples) < _STRESS_POINTS:
        return []
    points = np.array_split(np.arange(len(held_samples)), _STRESS_POINTS)
    time_s = np.array([held_samples.time_s[p].mean() for p in points]) - record.hold_start_s
    stress_kPa = np.array([held_samples.values[p].mean() for p in points]) / indenter.area_mm2 * 1e3
    trace = Trace("stress", "kPa", time_s, stress_kPa)
    return [_fit_trace("stress", trace, settings, loaded_change=None, steady=trace.end_level)]


def _cut(trace: Trace, start_s: float, end_s: float) -> Trace:
    inside_mask = (trace.time_s >= start_s) & (trace.time_s < end_s)
    return Trace(trace.name, trace.unit, trace.time_s[inside_mask] - start_s, trace.values[inside_mask])
