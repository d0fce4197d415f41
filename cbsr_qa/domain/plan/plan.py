"""Station, recipe and scene as read from their files."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings, CharacterisationSettings
from cbsr_qa.domain.plan.gate import GateSettings
from cbsr_qa.domain.plan.limits import FailureCode, Limit, LimitsVersion
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.readings.loads import Indenter


@dataclass(frozen=True, slots=True)
class PluginChoice:
    """A plugin by name, with options for its factory."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)


#: Reconstruction of recipes that image nothing; no plugin has this name.
NO_RECONSTRUCTION = PluginChoice("none")


#: Address of an instrument that the station itself emulates over a real byte stream.
EMULATED = "emulated"


@dataclass(frozen=True, slots=True)
class InstrumentSpec:
    """One instrument table of a station file.

    Parameters
    ----------
    provides : roles it fills for the runner: ``frame_source``, ``force_applicator``, ``source_meter``,
        ``multiplexer``, or the channel it samples.
    options : everything else in the table, for the driver.
    calibration_due : ISO date or None.
    model, serial : identity the instrument must report; empty to accept any.
    """

    role: str
    driver: str
    provides: tuple[str, ...]
    options: Mapping[str, Any]
    calibration_due: str | None
    model: str = ""
    serial: str = ""

    @property
    def emulated(self) -> bool:
        return self.options.get("address") == EMULATED

    @property
    def address(self) -> str:
        return str(self.options.get("address", "an address of the driver's choice"))


@dataclass(frozen=True, slots=True)
class EventSinkSpec:
    """A table ``[events.<name>]`` of a station file: where events of its runs are delivered."""

    name: str
    sink: PluginChoice


@dataclass(frozen=True, slots=True)
class Motion:
    """Speeds and reach of the head.

    Parameters
    ----------
    press_speed_mm_s : 40 mm/min in the paper.
    travel_speed_mm_s, hover_mm : speed between places, and height above the sheet.
    homing_s : time the machine takes to find the zero of its axes [s]; None where it goes there at its travel speed.
    clearance_mm : lowest height above the surface at which a sequence may let the head travel.
    """

    press_speed_mm_s: float
    travel_speed_mm_s: float
    hover_mm: float
    homing_s: float | None = None
    clearance_mm: float = 1.0


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Limits of the station, which no recipe can exceed.

    Parameters
    ----------
    strain : highest strain of a press.
    travel_radius_mm : furthest the head's centre may go from the sheet's centre.
    stale_s : force data older than this while pressed stop the run.
    dwell_s : longest time the head may stay down.
    compliance : share of a frame's readings at the source's compliance or the meter's limit that stops the run.
    heartbeat_s : longest interval between liveness checks while the runner waits.
    answer_s : beyond the time of its work, an instrument may be silent for this long before it counts as hanging.
    temperature_C : lowest and highest; None if unlimited.
    """

    force_N: float
    strain: float
    travel_radius_mm: float
    duration_s: float
    stale_s: float
    dwell_s: float = 3600.0
    compliance: float = 0.05
    heartbeat_s: float = 10.0
    answer_s: float = 120.0
    temperature_C: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class ReferenceRing:
    """A ring of resistors connected in place of a sensor, with the allowed deviations of its readings.

    Parameters
    ----------
    resistance_ohm : resistance of each resistor between neighbouring electrodes, the first between electrodes 0 and
        1; a single one if they are equal.
    tolerance : tolerance of a resistor, as a fraction: readings may differ by this much.
    gain : largest error of the gain, as a fraction.
    reading : largest deviation of a reading from the closed form, as a fraction, beside the tolerance.
    noise : largest rms noise of a reading, as a fraction of it.
    offset_V : largest common offset of all readings.
    lead_ohm : largest resistance of a lead, with its switch and contact.
    """

    resistance_ohm: tuple[float, ...]
    tolerance: float
    frames: int
    gain: float
    reading: float
    noise: float
    offset_V: float
    lead_ohm: float

    def resistances_ohm(self, electrodes: int) -> tuple[float, ...]:
        """Return one resistance for each electrode.

        Raises
        ------
        ConfigError
            If their number is neither 1 nor that of the electrodes.
        """
        count = len(self.resistance_ohm)
        if count not in (1, electrodes):
            raise ConfigError(
                f"[reference_ring] resistances_ohm has {count} values; the sensor type has {electrodes} electrodes",
                remedy=f"give {electrodes}, one for each pair of neighbours, or a single one for all",
            )
        return self.resistance_ohm * (electrodes if count == 1 else 1)


@dataclass(frozen=True, slots=True)
class SyncSettings:
    """Where a station sends what it stores, and how long that may wait.

    Parameters
    ----------
    centre : URL of the central database, without a password; empty if none is named.
    backlog_hours : longest time that something may wait [h]; None for any.
    """

    centre: str = ""
    backlog_hours: float | None = None


@dataclass(frozen=True, slots=True)
class CertificateSettings:
    """What a laboratory states on its calibration certificates.

    Parameters
    ----------
    laboratory, street, post_code, city, country : name and address; the country in ISO 3166-1.
    prefix : beginning of the number of every certificate.
    email : None if not stated.
    place, performed_at : where sensors are calibrated, in words, and as the digital certificate classes it.
    signatory, function : person who authorises certificates.
    validity_months : time that was agreed with the customer; None: no validity is stated.
    max_error_N, max_error_percent : maximum permissible error of a force, the sum of both parts; 0 for both: no
        statement of conformity.
    decision : ``"guarded"`` (guard band w = U, JCGM 106, 8.3.2) or ``"simple"`` (w = 0, 8.2); empty without a
        statement.
    """

    laboratory: str
    prefix: str
    street: str
    post_code: str
    city: str
    country: str
    place: str
    performed_at: str
    signatory: str
    function: str
    email: str | None = None
    validity_months: int | None = None
    max_error_N: float = 0.0
    max_error_percent: float = 0.0
    decision: str = ""

    @property
    def judges(self) -> bool:
        return self.max_error_N > 0 or self.max_error_percent > 0

    def max_error_of(self, force_N: float) -> float:
        """Maximum permissible error of a force [N]."""
        return self.max_error_N + self.max_error_percent / 100 * abs(force_N)


@dataclass(frozen=True, slots=True)
class Station:
    """A bench with instruments.

    Parameters
    ----------
    clock : ``"real"`` or ``"virtual"``; virtual only where every instrument is simulated.
    clock_speed : station seconds per second of a virtual clock that waits; None: it does not wait.
    sensor_type, material : names of the files used unless the command line says otherwise.
    emulated_scene : scene shared by its emulated instruments: a name, or a scene file's content; None if it has none.
    reference_ring : measured by ``cbsr-qa station check``; None if the station has none.
    gate : checks before every run.
    events : destinations of its runs' events, by name.
    signing_key : file with the private key that signs its calibrations; None: they are not signed.
    sync : centre to which its database is sent.
    standards : reference standards that its forces are traced to; those that are missing are not stated.
    certificate : what its certificates state; None: it issues none.
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
    reference_ring: ReferenceRing | None = None
    events: tuple[EventSinkSpec, ...] = ()
    clock_speed: float | None = None
    gate: GateSettings = field(default_factory=GateSettings)
    signing_key: Path | None = None
    sync: SyncSettings = field(default_factory=SyncSettings)
    standards: tuple[ReferenceStandard, ...] = ()
    certificate: CertificateSettings | None = None


@dataclass(frozen=True, slots=True)
class PhaseSpec:
    """One phase of a recipe: name, sequence plugin, options."""

    name: str
    sequence: str
    options: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Recipe:
    """What to measure on a sensor, and how to judge it.

    Parameters
    ----------
    sections : annexes of the report in order; empty for every installed section.
    annexes_if_passed : annexes of the report of a sensor that passed; None for the same.
    calibrate_phases : names of the phases whose loads calibrate.
    limits_version : version of those limits that carry one; may be None.
    characterisation : settings by which press cycles on a strip become a material's parameters; None for recipes that
        image sensors. If given, ``reconstruction`` is NO_RECONSTRUCTION and ``analysis`` is not used.
    failure_codes : codes of limits and rules, each once.
    """

    name: str
    phases: tuple[PhaseSpec, ...]
    reconstruction: PluginChoice
    metrics: tuple[PluginChoice, ...]
    analysis: AnalysisSettings
    limits: tuple[Limit, ...]
    calibrate_phases: tuple[str, ...]
    sections: tuple[str, ...] = ()
    annexes_if_passed: tuple[str, ...] | None = None
    limits_version: LimitsVersion | None = None
    characterisation: CharacterisationSettings | None = None
    failure_codes: tuple[FailureCode, ...] = ()


@dataclass(frozen=True, slots=True)
class Scene:
    """The simulated world: effects, drive current, mesh and reference ring.

    Parameters
    ----------
    effects : those that are on, in the order they are applied.
    frame_period_s : time of one frame (256 readings).
    sheet_mesh_size_mm : element size of the forward model far from the electrodes.
    not_modelled : neglected effects, in words.
    reference_ring_ohm : resistors of a ring connected in place of the sheet, the first between electrodes 0 and 1;
        empty for a sheet.
    """

    name: str
    effects: tuple[PluginChoice, ...]
    current_A: float
    frame_period_s: float
    sheet_mesh_size_mm: float
    not_modelled: tuple[str, ...]
    reference_ring_ohm: tuple[float, ...] = ()
