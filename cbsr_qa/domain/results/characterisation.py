"""Characterisation of a material from press cycles on a strip (paper 2.2)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.results.relaxation import RelaxationFit, SettlingTime
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Relaxation, Response, StripRelaxation

#: Measurements of the characterisation of a strip: names → units.
STRIP_MEASURES: Final[Mapping[str, str]] = {
    "gauge_factor": "1",
    "gauge_factor_intercept": "1",
    "local_gauge_factor": "1",
    "local_gauge_factor_intercept": "1",
    "gauge_factor_error": "%",
    "stress_sensitivity": "1/kPa",
    "stress_sensitivity_intercept": "1",
    "local_stress_sensitivity": "1/kPa",
    "local_stress_sensitivity_intercept": "1",
    "compressive_modulus": "kPa",
    "strain_offset": "1",
    "interelectrode_resistance": "ohm",
    "sheet_resistance": "ohm",
    "reading_noise": "1",
    "conductance_change": "1",
    "settling_time": "s",
    "common_settling_time": "s",
    "slow_residue": "1",
    "cycles_used": "1",
    "cycles_excluded": "1",
    "strains_excluded": "1",
    "lowest_strain": "1",
}


@dataclass(frozen=True, slots=True, eq=False)
class CycleReadings:
    """Readings of one press cycle.

    Parameters
    ----------
    load : index of the press within its phase.
    strain : nominal, as a fraction.
    cycle : 0-based among those of its strain.
    hold_start_s, rest_start_s : ends of the two ramps, on the run's clock.
    press_ramp_s, release_ramp_s : times that the strain took to rise and to fall [s]; 0 if unknown.
    held_s, held : (n,) times from the end of the press and relative conductance changes between the pins.
    rested_s, rested : the same from the end of the release.
    before : the last changes before the press, (k,).
    stress_s, stress_kPa : (m,) times from the end of the press and stress; empty where no force can be used.
    stress_why : why it is missing.
    """

    load: int
    strain: float
    cycle: int
    hold_start_s: float
    rest_start_s: float
    press_ramp_s: float
    release_ramp_s: float
    held_s: Array
    held: Array
    rested_s: Array
    rested: Array
    before: Array
    stress_s: Array
    stress_kPa: Array
    stress_why: str = ""


@dataclass(frozen=True, slots=True)
class CycleChange:
    """Relative conductance changes of one cycle.

    Parameters
    ----------
    load, strain, cycle : load, strain and cycle as in :class:`CycleReadings`.
    apparent, apparent_stderr : steady change between the pins, from the level that the rest before was going to.
    local, local_stderr : steady change under the head.
    from_before, from_rested : change between the pins at the end of the hold, from the last readings before it and
        from the rested strip.
    stress_kPa, stress_stderr_kPa : steady stress; None where no force can be used.
    """

    load: int
    strain: float
    cycle: int
    apparent: float
    apparent_stderr: float
    local: float
    local_stderr: float
    from_before: float
    from_rested: float
    stress_kPa: float | None
    stress_stderr_kPa: float | None


@dataclass(frozen=True, slots=True)
class StrainLevel:
    """Combined cycles of one strain.

    Parameters
    ----------
    strain : strain as a fraction.
    cycles : number of cycles used.
    mean, deviation : steady change between the pins, and its standard deviation over the cycles.
    local_mean, local_deviation : the same under the head.
    stress_kPa : mean; None without force.
    why : why the strain is left out of the lines, with the numbers; empty if it is not.
    """

    strain: float
    cycles: int
    mean: float
    deviation: float
    local_mean: float
    local_deviation: float
    stress_kPa: float | None
    why: str = ""


@dataclass(frozen=True, slots=True)
class FittedLine:
    """Line of relative conductance change against stress or strain, or the reason for none.

    Parameters
    ----------
    line : slope and intercept with standard errors and covariance; None where it cannot be fitted.
    parts : standard errors of the slope by where they come from.
    why : why there is no line.
    """

    line: QuasiStatic | None
    parts: tuple[tuple[str, float], ...] = ()
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class StrainSettling:
    """Relaxation and settling of all cycles of one strain, or of all strains, after one step.

    Parameters
    ----------
    signal : ``"conductance"`` (under the head) or ``"stress"``.
    loading : True after the press, False after the release.
    strain : None for all strains together.
    fit : fit of the mean trace, relative to the level before the press; time constants are common to all cycles.
    settling, stderr_s : and the standard error where it has a plain number.
    time_s, values : (n,) the mean trace that is drawn.
    traces : number of cycles.
    """

    signal: str
    loading: bool
    strain: float | None
    fit: RelaxationFit
    settling: SettlingTime
    stderr_s: float | None
    time_s: Array
    values: Array
    traces: int

    @property
    def words(self) -> str:
        """Signal and direction, e.g. ``"conductance, loading"``."""
        return f"{self.signal}, {'loading' if self.loading else 'unloading'}"


@dataclass(frozen=True, slots=True)
class StripFacts:
    """Geometry and resting state of the strip.

    Parameters
    ----------
    resistance_ohm : rested resistance between the pins.
    relative_noise : rms of one reading over their mean, rested.
    squares : resistance between the pins over the sheet resistance, by the forward model.
    contact_share : share of the resistance that is assumed to lie in the contacts.
    head_share : share of a small change under the head that shows between the pins.
    """

    resistance_ohm: Parameter
    relative_noise: float
    squares: float
    contact_share: float
    head_share: float


@dataclass(frozen=True, slots=True, eq=False)
class Characterisation:
    """Results of the cycles on a strip.

    Parameters
    ----------
    settings, strip : assumptions, and the strip that was characterised.
    cycles, levels : changes of every cycle that was used, and by strain.
    response : INCREASE or DECREASE; AUTO where the cycles do not say.
    against_strain, against_stress : lines between the pins, as in the paper (Eqs 1 and 2).
    local_against_strain, local_against_stress : lines under the head, corrected for the rest of the strip.
    end_of_hold : slopes against strain of the changes as they were read at the end of the holds, without what fits
        add: from before the press, and from the rested strip.
    modulus_kPa : slope of the steady stress against strain; None without one.
    strain_offset : strain where that line crosses zero stress: by how much the surface was missed.
    settlings : settlings by strain and of all strains.
    loading, unloading, stress : kernels of a unit step; None if not determined.
    relaxation : those of conductance by the estimator of sheets, with their errors; None without one.
    lowest_strain : least strain at which the local line is clear of zero; None where it never is.
    residue : share of a release that outlasts the relaxation, and the time constant it fades with [s]; None where
        none was found.
    unread : cycles that could not be used at all, by name.
    refused : why no material file may be issued; empty where one may.
    reduced : remarks on what was left out, or narrows the range of use.
    """

    settings: CharacterisationSettings
    strip: StripFacts
    cycles: tuple[CycleChange, ...]
    levels: tuple[StrainLevel, ...]
    response: Response
    against_strain: FittedLine
    against_stress: FittedLine
    local_against_strain: FittedLine
    local_against_stress: FittedLine
    end_of_hold: tuple[FittedLine, FittedLine]
    modulus_kPa: Parameter | None
    strain_offset: Parameter | None
    settlings: tuple[StrainSettling, ...]
    loading: Relaxation | None
    unloading: Relaxation | None
    stress: Relaxation | None
    relaxation: StripRelaxation | None
    lowest_strain: float | None
    residue: tuple[Parameter, Parameter] | None
    unread: tuple[str, ...]
    refused: tuple[str, ...]
    reduced: tuple[str, ...]
