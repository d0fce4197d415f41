"""Metrics of the images of a run: whether they show each load, where, how large, and how near two may be.

The figures of merit of single images are GREIT's (Adler et al. 2009).
"""

from dataclasses import astuple
from typing import ClassVar, Final

import numpy as np

from cbsr_qa.analysis.run.sizes import size_response_of
from cbsr_qa.eit.imaging.multi_load import two_touch_resolution
from cbsr_qa.eit.imaging.registration import Registration, register
from cbsr_qa.eit.imaging.shape import GreitFigures, greit_figures
from cbsr_qa.plugin import Bound, Dimensions, Image, LoadObservation, Measurement, NumericsError, Role, RunObservation
from cbsr_qa_plugins.metrics._shared import masks_of, measurement_of_load

_NAMES: Final = ("amplitude_response", "position_error", "resolution", "shape_deformation", "ringing")


class GreitFiguresOfMerit:
    """AR, PE [mm], RES, SD and RNG [1] of each load's steady image, nothing subtracted from it.

    The amplitude response is against the head's area times the change that the material file expects at the load's
    strain. The set q is what reaches a quarter of the maximum. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {name: "mm" if name == "position_error" else "1" for name in _NAMES}

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; an image without a positive element has no figures."""
        # Relative change that the material file predicts under the head.
        known = run.record.material.against_strain
        expected = abs(known.slope.value * load.record.load.strain + known.intercept.value)
        image = Image(load.image.mesh, load.response.sign * load.image.values)
        figures = greit_figures(image, load.pressed, contrast=expected if expected > 0 else None)
        values = (None,) * len(_NAMES) if figures is None else astuple(figures)
        return tuple(
            measurement_of_load(load, name, value, unit, how=_how(name, figures, expected))
            for (name, unit), value in zip(self.measures.items(), values, strict=True)
        )


def _how(name: str, figures: GreitFigures | None, expected: float) -> str:
    if figures is None:
        return "not detected: no element of the image has the sign of the response"
    if name == "amplitude_response":
        return f"against {100 * expected:.3g} % over the head's area" if expected > 0 else "no change is expected"
    if name == "ringing" and figures.ringing is None:
        return "the image's quarter amplitude set has nothing at its centre"
    return "of the set above a quarter of the maximum"


class LoadAssignment:
    """``false_regions`` [1] of each load and mask; ``missed_loads`` and ``merged_loads`` [1] of the run.

    A false region is one more than the loads that were held. Of several loads held at once each has the region that
    is assigned to it, a head's diameter away at most; one without is merged where it shares another's, else missed.
    The run's figures are of the main mask. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"false_regions": "1", "missed_loads": "1", "merged_loads": "1"}

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        return tuple(
            measurement_of_load(
                load,
                "false_regions",
                float(max(view.regions - load.together, 0)),
                "1",
                qualifier=qualifier,
                how=f"{view.regions} regions, {load.together} held; this one {view.fate}",
            )
            for view, qualifier in masks_of(load, run)
        )

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Count over all loads; a run without a load has no count."""
        views = [load.mask(run.main_mask) for load in run.loads]
        fates = [view.fate for view in views if view is not None]
        how = f"of {len(fates)} loads, at the {100 * run.main_mask:g} % mask" if fates else "nothing was pressed"
        return tuple(
            Measurement(f"{fate}_loads", float(fates.count(fate)) if fates else None, "1", how=how)
            for fate in ("missed", "merged")
        )


#: Highest mask tried: nothing lies above the maximum itself.
_HIGHEST: Final = 0.99
_WATERSHED: Final = "watershed"


class TwoTouchResolution:
    """``two_touch_resolution`` [mm]: smallest distance at which two equal loads show as two regions.

    Without qualifier for contours at the run's main mask, with ``"watershed"`` for peaks parted along the valley
    between them. Of the linearised model, without noise, along a line through the sheet's centre; the readings that
    were imaged are the run's. Where two are not seen up to 0.8 of the sheet's radius, that is a lower bound. It has
    no options.
    """

    measures: ClassVar[dict[str, str]] = {"two_touch_resolution": "mm"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        measured = []
        for qualifier, mask in (("", min(run.main_mask, _HIGHEST)), (_WATERSHED, None)):
            touch = two_touch_resolution(run.reconstruction, run.record.indenter, mask=mask)
            how = f"{describe_separation(qualifier, run)}; steps of {touch.step_mm:g} mm up to {touch.tried_mm:g} mm"
            value_mm, bound = touch.separation_mm, Bound.EXACT
            if value_mm is None:
                value_mm, bound, how = touch.tried_mm, Bound.LOWER, f"{how}: never two"
            measured.append(
                Measurement("two_touch_resolution", value_mm, "mm", qualifier=qualifier, how=how, bound=bound)
            )
        return tuple(measured)


def describe_separation(qualifier: str, run: RunObservation) -> str:
    """Describe how a ``two_touch_resolution`` with this qualifier distinguishes two loads."""
    if qualifier == _WATERSHED:
        return "valleys 5 % deep under the 25 % mask"
    return f"contours at {100 * min(run.main_mask, _HIGHEST):g} %"


_HOW = "centre of mass, less what all places share"
_WHOLE = {"registration_shift": "mm", "registration_rotation": "°", "registration_scale": "1"}


class RegistrationOfPlaces:
    """``registration_shift`` [mm], ``registration_rotation`` [°] and ``registration_scale`` of the places of a grid.

    A disc that is seated askew, or a station whose axes are off, moves all places alike; what is left of each load's
    centre-of-mass error without that is ``registered_centre_of_mass_error`` [mm]. The first three belong to the
    station, the last to the sensor. Of the loads of all phases that press a grid, under the main mask. It has no
    options.
    """

    measures: ClassVar[dict[str, str]] = {**_WHOLE, "registered_centre_of_mass_error": "mm"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        grids = {phase.name for phase in run.record.phases if phase.role is Role.GRID}
        loads = [load for load in run.loads if load.phase in grids]
        seen = [(load, place) for load in loads if (place := _find_centre(load, run))]
        nominal = np.array([load.place_mm for load, _ in seen]).reshape(-1, 2)
        try:
            registration = register(nominal, np.array([place for _, place in seen]).reshape(-1, 2))
        except NumericsError as error:
            why = f"not registered: {error.reason}"
            names = _WHOLE if loads else self.measures  # what nothing is left of is still a number that is lacking
            none = tuple(Measurement(name, None, unit, how=why) for name, unit in names.items())
            return (*none, *(_registration_error(load, None, why) for load in loads))
        errors = {id(load): float(error) for (load, _), error in zip(seen, registration.errors_mm, strict=True)}
        each = (
            _registration_error(load, errors.get(id(load)), _HOW if id(load) in errors else "not detected")
            for load in loads
        )
        return (*_whole(registration, len(seen)), *each)


def _find_centre(load: LoadObservation, run: RunObservation) -> tuple[float, float] | None:
    view = load.mask(run.main_mask)
    if view is None or view.region is None:
        return None
    x_mm, y_mm = view.region.centre_mm()
    return float(x_mm), float(y_mm)


def _whole(registration: Registration, count: int) -> tuple[Measurement, ...]:
    x_mm, y_mm = registration.shift_mm
    how = f"of {count} presses; the origin is seen at ({x_mm:.2f}, {y_mm:.2f}) mm"
    values = (
        (float(np.hypot(x_mm, y_mm)), registration.shift_stderr_mm),
        (registration.rotation_deg, registration.rotation_stderr_deg),
        (registration.scale, registration.scale_stderr),
    )
    return tuple(
        Measurement(name, value, unit, uncertainty=stderr, how=how)
        for (name, unit), (value, stderr) in zip(_WHOLE.items(), values, strict=True)
    )


def _registration_error(load: LoadObservation, error_mm: float | None, how: str) -> Measurement:
    return measurement_of_load(load, "registered_centre_of_mass_error", error_mm, "mm", how=how)


class SizeResponseMetric:
    """``size_response`` [1]: slope of a region's log area over the target's, 1 in proportion, 0 flat.

    One for the centre and one for 0.6 radii out, with round targets of 8/13, 1 and 20/13 of the head's diameter, at
    the run's main mask, without noise; ``region_area`` [mm²] of each target beside it, with its diameter in the
    qualifier. It has no options.
    """

    measures: ClassVar[dict[str, str]] = {"size_response": "1", "region_area": "mm²"}

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; no value if no target fits the sheet."""
        try:
            sizes = size_response_of(run)
        except NumericsError as error:
            return (Measurement("size_response", None, "1", how=error.reason),)
        measured = []
        for size in sizes:
            how = "not detected: targets leave no region"
            if size.slope is not None:
                flat = "flat: targets of every size leave nearly the same region; " if size.flat else ""
                how = f"{flat}mask {100 * run.main_mask:g} %, linearised model without noise"
            measured.append(Measurement("size_response", size.slope, "1", qualifier=size.place, how=how))
            for diameter, area in zip(size.diameters_mm, size.areas_mm2, strict=True):
                qualifier = Dimensions(size.place, target_mm=diameter).text
                why = "" if area is not None else "not detected: the target leaves no region"
                measured.append(Measurement("region_area", area, "mm²", qualifier=qualifier, how=why))
        return tuple(measured)
