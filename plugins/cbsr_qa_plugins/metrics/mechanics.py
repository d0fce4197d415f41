"""Force under the head, apparent modulus, and how evenly the sheet responds from place to place."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from cbsr_qa.calibration.fits.estimates import Estimate, relative_spread, slope
from cbsr_qa.calibration.sheet.characteristic import data_sheet_loads, why_no_force
from cbsr_qa.calibration.sheet.data_sheet import place_responses, scatter_of_presses
from cbsr_qa.plugin import LoadObservation, Measurement, NumericsError, RunObservation
from cbsr_qa_plugins.metrics._shared import format_count, measurement_of_load, percent, refuse_measurement

#: With this qualifier the spread is that of ρ̄₀ as it is, imaging included.
AS_IMAGED = "baseline conductance"


class Uniformity:
    """``uniformity`` [%]: standard deviation of the response over the locations, over its mean.

    Without a qualifier the response of a location is its ρ₀ (Eq 7) over what the linearised model of an even sheet
    images there; with ``baseline conductance`` it is ρ₀ itself, which differs from place to place on an even sheet
    too. At the strain at which the most locations were pressed. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"uniformity": "%"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        try:
            places, strain = place_responses(run, data_sheet_loads(run))
            own = relative_spread([place.response for place in places])
            imaged = relative_spread([place.baseline for place in places])
        except NumericsError as error:
            return (refuse_measurement("uniformity", "%", error),)
        presses = sum(len(place.responses) for place in places)
        how = f"{len(places)} locations at {100 * strain:g} % strain, {format_count(presses, 'press', 'presses')}"
        scatter = scatter_of_presses(places)
        alone = "" if scatter is None else f"; the scatter of presses alone would make {100 * scatter:.1f} %"
        return (
            percent("uniformity", own, f"ρ₀ relative to an even sheet imaged in the same way; {how}{alone}"),
            percent("uniformity", imaged, f"ρ₀ as imaged; {how}", qualifier=AS_IMAGED),
        )


_NAME, _UNIT, _SLOPE = "apparent_modulus", "kPa", "slope"


class ApparentModulus:
    """``apparent_modulus`` [kPa] of each location and of the run: relaxed stress under the head over nominal strain.

    With the qualifier ``slope`` it is the slope of stress against strain by least squares, which an error of the
    contact height does not touch; it needs two strains. Apparent: a flat head on a thin sheet is stiffer than the
    material (confinement), and the strain is that which was asked for. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {_NAME: _UNIT}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        points: dict[str, list[tuple[float, float]]] = {}
        loads = data_sheet_loads(run)
        for load in loads:
            if load.stress_kPa is not None:
                points.setdefault(load.record.load.label, []).append((load.record.load.strain, load.stress_kPa))
        if not points:
            why_not = NumericsError(f"nothing to divide by the strain: {why_no_force(loads)}")
            return (refuse_measurement(_NAME, _UNIT, why_not),)
        ratios = {place: _mean([stress / strain for strain, stress in pairs]) for place, pairs in points.items()}
        slopes = {place: fitted for place, pairs in points.items() if (fitted := _slope(pairs)) is not None}
        each = [
            _one(modulus, format_count(len(points[place]), "press", "presses"), qualifier, place)
            for qualifier, moduli in (("", ratios), (_SLOPE, slopes))
            for place, modulus in moduli.items()
        ]
        if slopes:
            return (_summarise_modulus(ratios, ""), _summarise_modulus(slopes, _SLOPE), *each)
        why = NumericsError("no location was pressed at two strains", remedy="give the recipe two strains or more")
        return (_summarise_modulus(ratios, ""), refuse_measurement(_NAME, _UNIT, why, qualifier=_SLOPE), *each)


def _slope(points: Sequence[tuple[float, float]]) -> Estimate | None:
    strain, stress = zip(*points, strict=True)
    try:
        return slope(strain, stress)
    except NumericsError:
        return None


def _mean(values: Sequence[float]) -> Estimate:
    count = len(values)
    stderr = float(np.std(values, ddof=1) / np.sqrt(count)) if count > 1 else None
    return Estimate(float(np.mean(values)), stderr, count - 1)


def _summarise_modulus(moduli: dict[str, Estimate], qualifier: str) -> Measurement:
    values = [modulus.value for modulus in moduli.values()]
    spread = "one location"
    if len(values) > 1:
        deviation = np.std(values, ddof=1)
        spread = f"{len(values)} locations, standard deviation between them {deviation:.3g} kPa"
    return _one(_mean(values), spread, qualifier)


def _one(modulus: Estimate, how: str, qualifier: str, location: str = "") -> Measurement:
    how = f"{'slope of relaxed stress against' if qualifier else 'relaxed stress over nominal'} strain; {how}"
    value, stderr = modulus.value, modulus.stderr
    return Measurement(_NAME, value, _UNIT, stderr, location=location, qualifier=qualifier, how=how)


class AppliedForce:
    """``force`` [N] of each load: the load cell's mean over the steady frames. It has no options."""

    measures: ClassVar[dict[str, str]] = {"force": "N"}

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        how = "no force was recorded" if load.force_N is None else f"mean over {load.steady_frames} steady frames"
        return (measurement_of_load(load, "force", load.force_N, "N", uncertainty=load.force_stderr_N, how=how),)
