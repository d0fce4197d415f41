"""Values of a simulated run that the publication's tables need."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.force import RunForce
from cbsr_qa.calibration.fits.settling import estimate_restricted_mean
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.characterisation import Characterisation, FittedLine
from cbsr_qa.domain.results.dimensions import Dimensions
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.eit.inverse.scaling import changes
from cbsr_qa.studies.reproduce.compare import Ours

#: Frames of a noise floor (paper 3.2.1).
_FLOOR_FRAMES: Final = 8
#: Strain of Tables 3 and 4.
_TABLE_STRAIN: Final = 0.2
#: Mean and deviation of error [mm], overlap [%] and deviation [mm²] over frames.
Spatial = tuple[Ours, Ours, Ours]
_METRICS: Final = ("centre_of_mass_error", "area_overlap", "shape_deviation")


@dataclass(frozen=True, slots=True)
class ForcePress:
    """Force of one press, by the load cell and by one response for the whole sheet [N]."""

    place: str
    measured_N: float
    global_N: float


@dataclass(frozen=True, slots=True)
class SettlingOf:
    """Settling of one strain (None: all traces fitted together) after loading or unloading."""

    strain: float | None
    loading: bool
    ours: Ours


@dataclass(frozen=True, slots=True)
class SheetValues:
    """Values of one simulated sheet.

    Parameters
    ----------
    resistance, modulus, noise_figure, noise_floor, noise : R_int [kΩ], E [kPa], NF, relative floor, relative σ_n.
    by_mask : percentage mask → values over all held frames at 20 % strain.
    by_place : location → the same with the main mask.
    random : place of the list → error and deviation over trials, steady images.
    settlings : settling of the conductance under the load, by strain.
    presses : single presses, each left out of its own force model.
    stress_slope_per_kPa, head_mm2 : response per stress and area of the head, for the detection limit.
    """

    sheet: str
    resistance: Ours
    modulus: Ours
    noise_figure: Ours
    noise_floor: Ours
    noise: Ours
    by_mask: tuple[tuple[float, Spatial], ...]
    by_place: tuple[tuple[str, Spatial], ...]
    random: tuple[tuple[Ours, Ours], ...]
    size_ratio: tuple[tuple[float, float], ...]
    settlings: tuple[SettlingOf, ...]
    presses: tuple[ForcePress, ...]
    stress_slope_per_kPa: float
    head_mm2: float
    station_s: float
    compute_s: float


@dataclass(frozen=True, slots=True)
class StripValues:
    """Values of one simulated strip: gauge factors under the head and between the pins, E [kPa], settling."""

    local_gauge_factor: Ours
    gauge_factor: Ours
    modulus: Ours
    settlings: tuple[SettlingOf, ...]
    station_s: float
    compute_s: float


def sheet_values(
    run: RunObservation,
    measurements: Sequence[Measurement],
    force: RunForce,
    sheet: str,
    station_s: float,
    compute_s: float,
) -> SheetValues:
    """Reduce an analysed run."""
    resistance = _run_value(measurements, "interelectrode_resistance", "", sheet, "deviation between pairs", 1e-3)
    slope = run.record.material.against_stress.slope.value
    places = list(dict.fromkeys(load.record.load.label for load in _grid(run)))
    size_ratios = []
    for mask in run.settings.masks:
        # Mean A_b/A_FA of the steady images at the tables' strain; 0 without blobs.
        views = [(load.mask(mask), load.indenter.area_mm2) for load in _grid(run)]
        ratios = [view.region.area_mm2 / area for view, area in views if view is not None and view.region is not None]
        size_ratios.append((mask, float(np.mean(ratios)) if ratios else 0.0))
    return SheetValues(
        sheet=sheet,
        resistance=resistance,
        modulus=_run_value(measurements, "apparent_modulus", "slope", sheet, "deviation between locations"),
        noise_figure=_run_value(measurements, "noise_figure", "", sheet, "standard error"),
        noise_floor=_noise_floor(run, sheet),
        noise=_run_value(measurements, "conductance_noise", "per element", sheet, "standard error"),
        by_mask=tuple((mask, _spatial(run, mask, sheet)) for mask in run.settings.masks),
        by_place=tuple((place, _spatial(run, run.main_mask, sheet, place)) for place in places),
        random=_random(run, measurements, sheet),
        size_ratio=tuple(size_ratios),
        settlings=tuple(_settlings(run, measurements, sheet)),
        presses=tuple(
            ForcePress(test.load.record.load.label, test.measured_N, test.global_N) for test in force.tests
        ),
        stress_slope_per_kPa=slope,
        head_mm2=run.record.indenter.area_mm2,
        station_s=station_s,
        compute_s=compute_s,
    )


def strip_values(strip: Characterisation, station_s: float, compute_s: float) -> StripValues:
    """Reduce a characterisation."""
    modulus = strip.modulus_kPa
    return StripValues(
        local_gauge_factor=_slope(strip.local_against_strain, "under the head"),
        gauge_factor=_slope(strip.against_strain, "between the pins"),
        modulus=Ours("strip", None, uncertainty_is="no stress")
        if modulus is None
        else Ours("strip", modulus.value, modulus.stderr, "standard error"),
        settlings=tuple(
            SettlingOf(
                fit.strain,
                fit.loading,
                Ours(
                    "strip",
                    fit.settling.value_s,
                    fit.stderr_s,
                    fit.settling.why or "standard error",
                    fit.traces,
                    fit.settling.censored,
                ),
            )
            for fit in strip.settlings
            if fit.signal == "conductance"
        ),
        station_s=station_s,
        compute_s=compute_s,
    )


def _slope(fitted: FittedLine, where: str) -> Ours:
    if fitted.line is None:
        return Ours("strip", None, uncertainty_is=fitted.why)
    return Ours("strip", fitted.line.slope.value, fitted.line.slope.stderr, f"standard error; {where}")


def _run_value(
    measurements: Iterable[Measurement], name: str, qualifier: str, sheet: str, of: str, scale: float = 1.0
) -> Ours:
    """Take the measurement of the whole run, or of its only location."""
    for measurement in measurements:
        if (measurement.name, measurement.qualifier, measurement.location) == (name, qualifier, ""):
            if measurement.value is None:
                return Ours(sheet, None, uncertainty_is=measurement.how)
            uncertainty = None if measurement.uncertainty is None else scale * measurement.uncertainty
            return Ours(sheet, scale * measurement.value, uncertainty, of)
    return Ours(sheet, None, uncertainty_is="not measured")


def _noise_floor(run: RunObservation, sheet: str) -> Ours:
    """Mean and deviation of the floor over disjoint sets of eight unloaded frames, relative to the others' mean."""
    frames, problem = run.unloaded.voltages, run.reconstruction.problem
    floors = []
    for start in range(0, len(frames) - _FLOOR_FRAMES + 1, _FLOOR_FRAMES):
        is_chosen = np.zeros(len(frames), dtype=np.bool_)
        is_chosen[start : start + _FLOOR_FRAMES] = True
        readings = changes(frames[is_chosen], frames[~is_chosen].mean(axis=0), problem, run.scale)
        floors.append(float(np.abs(run.reconstruction.images(readings)).max()))
    if len(floors) < 2:
        return Ours(sheet, None, uncertainty_is="too few unloaded frames")
    meaning = f"deviation over {len(floors)} sets of {_FLOOR_FRAMES} frames"
    return Ours(sheet, float(np.mean(floors)), float(np.std(floors, ddof=1)), meaning, len(floors))


def _grid(run: RunObservation, place: str = "") -> list[LoadObservation]:
    """Loads of the nine locations at the tables' strain."""
    phases = {phase.name for phase in run.record.phases if phase.role is Role.GRID}
    return [
        load
        for load in run.loads
        if load.phase in phases
        and abs(load.record.load.strain - _TABLE_STRAIN) < 1e-6
        and place in ("", load.record.load.label)
    ]


def _spatial(run: RunObservation, mask: float, sheet: str, place: str = "") -> Spatial:
    """Mean and deviation over every frame of the holds, as the paper's Fig 10 has them."""
    columns: list[list[Array]] = [[], [], []]
    for load in _grid(run, place):
        timeline = next(timeline for timeline in run.timelines if timeline.phase == load.phase)
        row = timeline.masks.index(mask)
        is_held = (timeline.time_s >= load.record.hold_start_s) & (timeline.time_s < load.record.release_start_s)
        figures_by_mask = (timeline.error_mm, timeline.overlap_percent, timeline.deviation_mm2)
        for column, values in zip(columns, figures_by_mask, strict=True):
            column.append(values[row][is_held])
    held_values = [np.concatenate(column) if column else np.zeros(0) for column in columns]
    has_blob = np.isfinite(held_values[0])
    if has_blob.sum() < 2:
        nothing = Ours(sheet, None, uncertainty_is="no blob was seen")
        return nothing, nothing, nothing
    lost_count = int((~has_blob).sum())
    meaning = f"deviation over {int(has_blob.sum())} held frames" + (
        f"; {lost_count} without a blob" if lost_count else ""
    )
    error, overlap, deviation = (
        Ours(
            sheet,
            float(figure_values[has_blob].mean()),
            float(figure_values[has_blob].std(ddof=1)),
            meaning,
            int(has_blob.sum()),
        )
        for figure_values in held_values
    )
    return error, overlap, deviation


def _random(run: RunObservation, measurements: Sequence[Measurement], sheet: str) -> tuple[tuple[Ours, Ours], ...]:
    phases = {phase.name for phase in run.record.phases if phase.role is Role.RANDOM}
    labels = dict.fromkeys(load.record.load.label for load in run.loads if load.phase in phases)
    rows = []
    for label in labels:
        of_load = [m for m in measurements if m.phase in phases and m.location == label and not m.qualifier]
        error, _, deviation = (_summarise_trials([m for m in of_load if m.name == name], sheet) for name in _METRICS)
        rows.append((error, deviation))
    return tuple(rows)


def _summarise_trials(measurements: Sequence[Measurement], sheet: str) -> Ours:
    values = [m.value for m in measurements if m.value is not None]
    if not values:
        return Ours(sheet, None, uncertainty_is=measurements[0].how if measurements else "not pressed")
    undetected_count = len(measurements) - len(values)
    meaning = f"deviation over {len(values)} trials" if len(values) > 1 else "one trial"
    meaning += f"; {undetected_count} not detected" if undetected_count else ""
    deviation = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return Ours(sheet, float(np.mean(values)), deviation, meaning, len(values))


def _settlings(run: RunObservation, measurements: Sequence[Measurement], sheet: str) -> Iterable[SettlingOf]:
    phases = {phase.name for phase in run.record.phases if phase.role is Role.GRID}
    loads = [load for load in run.loads if load.phase in phases]
    for loading in (True, False):
        for strain in sorted({load.record.load.strain for load in loads}):
            strain_loads = [load for load in loads if load.record.load.strain == strain]
            yield SettlingOf(strain, loading, _mean_settling(strain_loads, loading, sheet))
        qualifier = Dimensions("conductance", "loading" if loading else "unloading").text
        together = _run_value(measurements, "common_settling_time", qualifier, sheet, "standard error")
        yield SettlingOf(None, loading, together)


def _mean_settling(loads: Sequence[LoadObservation], loading: bool, sheet: str) -> Ours:
    fits = [
        fit for load in loads for fit in load.relaxations if (fit.signal, fit.loading) == ("conductance", loading)
    ]
    settling_times = [(f.settling.value_s, f.settling.censored) for f in fits if f.settling.value_s is not None]
    fit_count_words = f"{len(settling_times)} of {len(fits)} fits kept (R² of at least 0.85)"
    if not settling_times or 2 * len(settling_times) < len(fits):
        return Ours(sheet, None, uncertainty_is=fit_count_words, count=len(settling_times))
    censored_count = sum(censored for _, censored in settling_times)
    mean_s, deviation_s = estimate_restricted_mean(
        [time_s for time_s, _ in settling_times], [censored for _, censored in settling_times]
    )
    meaning = f"standard error; {fit_count_words}" + (f", {censored_count} not settled" if censored_count else "")
    return Ours(
        sheet, mean_s, deviation_s / len(settling_times) ** 0.5, meaning, len(settling_times), censored_count > 0
    )
