"""Lines through the steady changes of press cycles with every part of their uncertainty (paper Eqs 1 and 2)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import fmean, stdev
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.quasi_static import QuasiStaticFit, fit_quasi_static
from cbsr_qa.calibration.sheet.baseline import predict_change
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.results.characterisation import Characterisation, CycleChange, FittedLine, StrainLevel
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Response

#: A change differs clearly from zero if it is this many of its standard errors.
CLEAR: Final = 3.0

#: Abscissa of a line: takes a cycle and returns its place, or None to leave the cycle out.
Place = Callable[[CycleChange], float | None]
#: Changes of the same cycles with each unknown one standard error off, by its name.
Moved = Mapping[str, Sequence[Sequence[float]]]


def strain_levels(cycles: Sequence[CycleChange]) -> tuple[StrainLevel, ...]:
    """Group cycles by strain, and name the strains to be left out of lines.

    A strain whose deviation over the cycles exceeds its mean change is left out (paper 3.1.1: 5 % of 9 wt%), and so
    is one with some cycles clearly of the other sign.
    """
    strains = sorted({cycle.strain for cycle in cycles})
    return tuple(_make_level(strain, [cycle for cycle in cycles if cycle.strain == strain]) for strain in strains)


def _make_level(strain: float, members: Sequence[CycleChange]) -> StrainLevel:
    apparent, local = [c.apparent for c in members], [c.local for c in members]
    stress = [c.stress_kPa for c in members if c.stress_kPa is not None]
    level = StrainLevel(
        strain,
        len(members),
        fmean(apparent),
        stdev(apparent) if len(apparent) > 1 else 0.0,
        fmean(local),
        stdev(local) if len(local) > 1 else 0.0,
        fmean(stress) if stress else None,
    )
    return replace(level, why=_why_left_out(level, members))


def _why_left_out(level: StrainLevel, members: Sequence[CycleChange]) -> str:
    label = f"{100 * level.strain:g} % strain"
    if level.deviation > abs(level.mean):
        return (
            f"{label}: the deviation over {level.cycles} cycles, {level.deviation:.2g}, exceeds the mean change of"
            f" {level.mean:.2g}"
        )
    opposing = [c for c in members if c.apparent * level.mean < 0 and abs(c.apparent) > CLEAR * c.apparent_stderr]
    if opposing:
        return (
            f"{label}: {len(opposing)} of {level.cycles} cycles change the other way (cycle"
            f" {opposing[0].cycle + 1} by {opposing[0].apparent:+.2g}, the mean is {level.mean:+.2g})"
        )
    return ""


def decide_response(levels: Sequence[StrainLevel], declared: Response) -> tuple[Response, str]:
    """Return the material's response to a load, or AUTO if it is undetermined with the reason."""
    used_levels = [level for level in levels if not level.why]
    if not used_levels:
        return Response.AUTO, "no strain changes the conductance clearly"
    rising = [level for level in used_levels if level.mean > 0]
    falling = [level for level in used_levels if level.mean <= 0]
    if rising and falling:
        rising_level, falling_level = rising[0], falling[0]
        return Response.AUTO, (
            f"strains disagree in sign: {100 * rising_level.strain:g} % changes the conductance by"
            f" {rising_level.mean:+.2g}, {100 * falling_level.strain:g} % by {falling_level.mean:+.2g}"
        )
    voted = Response.INCREASE if rising else Response.DECREASE
    if declared not in (Response.AUTO, voted):
        return voted, f"the cycles say {voted}, the sensor type says {declared}"
    return voted, ""


def fit_line(
    cycles: Sequence[CycleChange],
    changes: Sequence[float],
    errors: Sequence[float],
    place: Place,
    moved: Moved,
    source: str,
) -> FittedLine:
    """Fit a line through the mean change of each strain, and add errors not in the cycles' scatter.

    Parameters
    ----------
    cycles : cycles of the strains that are not left out.
    changes, errors : change of each cycle, and its standard error.
    place : abscissa of the line.
    moved : shifted changes, see :data:`Moved`; each set moves the line, and its squares are added to the covariance.
    source : source of the parameters.
    """
    used_cycles = [k for k, cycle in enumerate(cycles) if place(cycle) is not None]
    strains = [cycles[k].strain for k in used_cycles]
    abscissae = [float(place(cycles[k]) or 0.0) for k in used_cycles]

    def fit(values: Sequence[float]) -> QuasiStaticFit:
        return fit_quasi_static(
            strains, abscissae, [values[k] for k in used_cycles], [errors[k] for k in used_cycles]
        )

    try:
        line = fit(changes)
        shifts = {
            name: [np.array([other.slope - line.slope, other.intercept - line.intercept]) for other in map(fit, sets)]
            for name, sets in moved.items()
        }
    except NumericsError as error:
        return FittedLine(None, why=f"{error.reason}; {error.remedy}".removesuffix("; "))
    covariance = line.covariance + sum((np.outer(d, d) for sets in shifts.values() for d in sets), np.zeros((2, 2)))
    error_sources = [("scatter of the cycles", float(np.sqrt(line.covariance[0, 0])))]
    error_sources += [(name, float(np.sqrt(sum(d[0] ** 2 for d in sets)))) for name, sets in shifts.items() if sets]
    return FittedLine(replace(line, covariance=covariance).as_parameters(source), tuple(error_sources))


def lowest_clear_strain(line: QuasiStatic | None, strains: Sequence[float]) -> float | None:
    """Least of some strains at which α ε + β is three of its standard errors from zero, or None."""
    if line is None:
        return None
    for strain in sorted(strains):
        predicted, error = predict_change(line, strain)
        if abs(predicted) >= CLEAR * error and predicted != 0:
            return strain
    return None


def fit_modulus(cycles: Sequence[CycleChange], source: str) -> tuple[Parameter | None, Parameter | None, str]:
    """Fit stress against strain: slope E [kPa] and the strain of the zero crossing, or why there is neither."""
    pressed = [(c.strain, c.stress_kPa, c.stress_stderr_kPa or 0.0) for c in cycles if c.stress_kPa is not None]
    try:
        strain, stress, error = zip(*pressed, strict=True) if pressed else ((), (), ())
        fit = fit_quasi_static(strain, strain, stress, error)
    except NumericsError as refused:
        return None, None, refused.reason
    if fit.slope <= CLEAR * float(np.sqrt(fit.covariance[0, 0])):
        return None, None, f"the stress does not rise clearly with the strain (slope {fit.slope:.3g} kPa)"
    crossing = -fit.intercept / fit.slope
    gradient = np.array([-crossing, -1.0]) / fit.slope
    modulus = Parameter(fit.slope, float(np.sqrt(fit.covariance[0, 0])), source)
    return modulus, Parameter(crossing, float(np.sqrt(gradient @ fit.covariance @ gradient)), source), ""


#: Data are taken after at least this many settling times (science, section 8).
_MULTIPLE: Final = 1.5
#: Largest share of a release that outlasts its rest and is a residue: with more, rests are too short to decide.
_MOST_RESIDUE: Final = 0.1


def why_refused(material: Characterisation, disagreement: str, why_no_modulus: str) -> tuple[str, ...]:
    """Reasons why this cannot represent the material."""
    reasons = [disagreement] if disagreement else []
    for name, line in (("strain", material.local_against_strain), ("stress", material.local_against_stress)):
        if line.line is None:
            reasons.append(f"no line against {name}: {line.why}")
    if material.local_against_strain.line is not None and material.lowest_strain is None:
        reasons.append("α ε + β is not clear of zero at any strain")
    if material.modulus_kPa is None:
        reasons.append(f"no modulus: {why_no_modulus}")
    for name, kernel in (
        ("loading", material.loading),
        ("unloading", material.unloading),
        ("stress", material.stress),
    ):
        if kernel is None:
            why = next(
                (s.fit.why for s in material.settlings if s.strain is None and name in s.words), "not recorded"
            )
            reasons.append(f"no relaxation of {name}: {why}")
    if material.residue is not None and material.residue[0].value > _MOST_RESIDUE:
        reasons.append(
            f"{100 * material.residue[0].value:.2g} % of every release outlasts its rest: holds and rests are too"
            " short for steady levels"
        )
    return tuple(dict.fromkeys(reasons))


def why_reduced(material: Characterisation, why_no_stress: Sequence[str]) -> tuple[str, ...]:
    """Everything left out, or narrowing the range of use."""
    reasons = [f"left out: {level.why}" for level in material.levels if level.why]
    reasons += why_no_stress
    reasons += _name_short_holds(material)
    used_strains = [level.strain for level in material.levels if not level.why]
    if material.lowest_strain is not None and material.lowest_strain > min(used_strains):
        reasons.append(
            f"α ε + β is clear of zero from {100 * material.lowest_strain:g} % strain on: below, it says nothing"
        )
    return tuple(reasons)


def _name_short_holds(material: Characterisation) -> Iterator[str]:
    """Holds and rests that end before levels are settled, and so are extrapolated by the fits."""
    for relaxation in material.settlings:
        if relaxation.strain is not None or relaxation.settling.value_s is None or not len(relaxation.time_s):
            continue
        window_s, needed_s = float(relaxation.time_s[-1]), _MULTIPLE * relaxation.settling.value_s
        if needed_s > window_s or relaxation.settling.censored:
            least = "at least " if relaxation.settling.censored else ""
            yield (
                f"{'holds' if relaxation.loading else 'rests'} of {window_s:.3g} s are shorter than"
                f" {_MULTIPLE:g} settling times of {relaxation.signal} ({least}{relaxation.settling.value_s:.3g} s):"
                " steady levels are extrapolated"
            )
