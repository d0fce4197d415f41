"""What is going to happen: the station, the recipe and the scene, as read from their files."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cbsr_qa.domain.calibration import OverlapBand
from cbsr_qa.domain.characterisation import CharacterisationSettings
from cbsr_qa.domain.limits_version import LimitsVersion
from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.measurement import Limit


@dataclass(frozen=True, slots=True)
class PluginChoice:
    """A plugin by name, with the options its factory is given."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)


#: Of recipes that image nothing; no plugin has this name.
NO_RECONSTRUCTION = PluginChoice("none")


#: Address of an instrument that the station itself emulates over a real byte stream.
EMULATED = "emulated"


@dataclass(frozen=True, slots=True)
class InstrumentSpec:
    """One instrument table of a station file.

    Parameters
    ----------
    role : the table's name.
    driver : name of the instrument plugin.
    provides : roles it fills for the runner: ``frame_source``, ``force_applicator``, or any name for a sampler.
    options : everything else in the table, for the driver.
    calibration_due : ISO date or None.
    """

    role: str
    driver: str
    provides: tuple[str, ...]
    options: Mapping[str, Any]
    calibration_due: str | None

    @property
    def emulated(self) -> bool:
        """Whether its address is the word for an instrument that the station emulates."""
        return self.options.get("address") == EMULATED


@dataclass(frozen=True, slots=True)
class Motion:
    """How the head moves.

    Parameters
    ----------
    press_speed_mm_s : 40 mm/min in the paper.
    travel_speed_mm_s, hover_mm : between places, and how high above the sheet.
    """

    press_speed_mm_s: float
    travel_speed_mm_s: float
    hover_mm: float


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """What the station allows, whatever a recipe asks for.

    Parameters
    ----------
    force_N : ceiling of the measured force.
    strain : highest strain a press may ask for.
    travel_radius_mm : furthest the head's centre may go from the sheet's centre.
    duration_s : longest run.
    stale_s : force data older than this while pressed stop the run.
    """

    force_N: float
    strain: float
    travel_radius_mm: float
    duration_s: float
    stale_s: float


@dataclass(frozen=True, slots=True)
class Station:
    """A bench with instruments.

    Parameters
    ----------
    clock : ``"real"`` or ``"virtual"``; virtual only where every instrument is simulated.
    sensor_type, material : names of the files used unless the command line says otherwise.
    emulated_scene : of the world that its emulated instruments share: a name, or a scene file's content; None where
        it emulates none.
    """

    name: str
    clock: str
    sensor_type: str
    material: str
    indenter: Indenter
    motion: Motion
    safety: SafetyLimits
    instruments: tuple[InstrumentSpec, ...]
    emulated_scene: str | Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class PhaseSpec:
    """One phase of a recipe: a name, the sequence plugin that makes its steps, its options."""

    name: str
    sequence: str
    options: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class AnalysisSettings:
    """How images become numbers; every choice the paper leaves open, named.

    Parameters
    ----------
    masks : percentage masks to report, as fractions.
    main_mask : the one the verdict uses; must be among ``masks``.
    noise_floor_frames : unloaded frames the floor is taken from (the paper's first eight).
    reference : ``"run"`` (mean of the rested frames without the noise-floor ones) or ``"load"`` (before each press).
    reference_frames : frames before each press that ``"load"`` averages.
    steady_frames : at most this many frames at the end of a hold make the steady image.
    settling_multiple : a hold is settled from this multiple of the settling time on.
    settling_tolerance : half width of the settling band.
    settling_band : ``"steady"`` (of the steady change) or ``"step"`` (of the relaxing part).
    r_squared_gate : fits below are rejected.
    overlap_bands : names of the area-overlap scale.
    size_ratio : lowest and highest A_b/A_FA for which a band counts.
    clipping : ``"exact"`` or ``"centroid"``.
    perimeter : ``"length"`` or ``"nodes"``.
    outline : of a sensed region: ``"contour"`` (inside the elements) or ``"elements"`` (whole ones, the paper's).
    noise_weighting : ``"equal"`` (all readings count alike) or ``"measured"`` (by their noise when unloaded).
    calibrate_phases : names of the phases whose loads the calibration is taken from; loads of others test it.
    transients : of short holds, for the force model: ``"averaged"`` (their last frames count as they are) or
        ``"predicted"`` (to where the run's longest holds end).
    """

    masks: tuple[float, ...]
    main_mask: float
    noise_floor_frames: int
    reference: str
    reference_frames: int
    steady_frames: int
    settling_multiple: float
    settling_tolerance: float
    settling_band: str
    r_squared_gate: float
    overlap_bands: tuple[OverlapBand, ...]
    size_ratio: tuple[float, float]
    clipping: str
    perimeter: str
    outline: str
    noise_weighting: str = "equal"
    calibrate_phases: tuple[str, ...] = ()
    transients: str = "averaged"


@dataclass(frozen=True, slots=True)
class Recipe:
    """What is done to a sensor and how it is judged.

    Parameters
    ----------
    sections : report sections in order; empty for every installed one.
    calibrate_phases : names of the phases whose loads the calibration is taken from.
    limits_version : of those limits that carry one; None where none does.
    characterisation : how press cycles on a strip become a material's parameters; None where sensors are imaged.
        Where it is there, ``reconstruction`` is NO_RECONSTRUCTION and of ``analysis`` nothing is used.
    """

    name: str
    phases: tuple[PhaseSpec, ...]
    reconstruction: PluginChoice
    metrics: tuple[PluginChoice, ...]
    analysis: AnalysisSettings
    limits: tuple[Limit, ...]
    calibrate_phases: tuple[str, ...]
    sections: tuple[str, ...] = ()
    limits_version: LimitsVersion | None = None
    characterisation: CharacterisationSettings | None = None


@dataclass(frozen=True, slots=True)
class Scene:
    """What the simulated world contains.

    Parameters
    ----------
    effects : those that are on, in the order they are applied.
    current_A : drive current.
    frame_period_s : time of one frame (256 readings).
    sheet_mesh_size_mm : element size of the forward model far from the electrodes.
    not_modelled : what this world leaves out, in words.
    """

    name: str
    effects: tuple[PluginChoice, ...]
    current_A: float
    frame_period_s: float
    sheet_mesh_size_mm: float
    not_modelled: tuple[str, ...]
