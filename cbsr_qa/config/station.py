"""Station files: the instruments of the bench and its limits."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from cbsr_qa.config.choices import Choice, read_choice
from cbsr_qa.config.documents import reference_path
from cbsr_qa.config.gate import GateTable
from cbsr_qa.config.standards import StandardsTable
from cbsr_qa.config.tables import PRINTABLE, FileModel, IsoDate, OpenTable, Word, as_domain
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.plan import (
    EMULATED,
    CertificateSettings,
    EventSinkSpec,
    InstrumentSpec,
    Motion,
    PluginChoice,
    ReferenceRing,
    SafetyLimits,
    Station,
    SyncSettings,
)
from cbsr_qa.domain.plan.standards import IN_USE_YEARS, StandardRole
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.problems import Problem, Table

Positive = Annotated[float, Field(gt=0)]
Corner = Annotated[list[float], Field(min_length=2, max_length=2)]
Name = Annotated[str, Field(min_length=1, max_length=64)]
Resistance = Annotated[float, Field(ge=1e-3, le=1e9)]

#: Roles that every run needs filled.
NEEDED_ROLES = ("frame_source", "force_applicator")
#: Option keys of instrument tables that name another configuration file.
REFERENCES = ("scene", "material", "sensor_type")


class StationTable(Table):
    """``[station]``."""

    name: Name
    clock: Literal["virtual", "real"]
    clock_speed: Annotated[float, Field(ge=1, le=1e5)] | None = None
    sensor_type: Name
    material: Name
    overdue: Literal["warn", "refuse"] | None = None

    def problems(self) -> Iterator[Problem]:
        if self.clock_speed is not None and self.clock != "virtual":
            yield Problem(("station", "clock_speed"), 'is given, but only a clock = "virtual" has a speed')


class IndenterTable(Table):
    """``[indenter]``: the flat head, round (13 mm unless it says otherwise) or of any outline."""

    diameter_mm: Positive | None = None
    outline_mm: Annotated[list[Corner], Field(min_length=3)] | None = None

    def problems(self, table: str = "indenter") -> Iterator[Problem]:
        if self.outline_mm is None:
            return
        if self.diameter_mm is not None:
            yield Problem((table, "diameter_mm"), "is given beside outline_mm; a head has one or the other")
        try:
            self.to_domain()
        except NumericsError as error:
            yield Problem((table, "outline_mm"), f"is not an outline: {error.reason}. {error.remedy}".strip())

    def to_domain(self) -> Indenter:
        if self.outline_mm is None:
            return Indenter(13.0 if self.diameter_mm is None else self.diameter_mm)
        return Indenter.with_outline((x, y) for x, y in self.outline_mm)


class MotionTable(Table):
    """``[motion]``. The press speed defaults to the paper's 40 mm/min."""

    press_speed_mm_per_min: Positive = 40.0
    travel_speed_mm_per_min: Positive
    hover_mm: Positive
    homing_s: Positive | None = None
    clearance_mm: Positive = 1.0


class SafetyTable(Table):
    """``[safety]``: limits of this station for any recipe."""

    force_N: Positive
    strain_percent: Annotated[float, Field(gt=0, lt=100)]
    travel_radius_mm: Positive
    duration_h: Positive
    stale_s: Positive
    dwell_s: Positive = 3600.0
    compliance_percent: Annotated[float, Field(gt=0, le=100)] = 5.0
    heartbeat_s: Positive = 10.0
    answer_s: Positive = 120.0
    temperature_C: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None

    def problems(self) -> Iterator[Problem]:
        if self.temperature_C is not None and not self.temperature_C[0] < self.temperature_C[1]:
            yield Problem(("safety", "temperature_C"), "is no range; give the lowest and then the highest")

    def to_domain(self) -> SafetyLimits:
        return as_domain(SafetyLimits, self, duration_s=self.duration_h * 3600)


class EmulationTable(Table):
    """``[emulation]``: the one simulated world behind every instrument whose address is "emulated"."""

    scene: Name


class ReferenceRingTable(Table):
    """``[reference_ring]``: resistors in place of a sensor, and their limits in ``cbsr-qa station check``."""

    resistance_ohm: Resistance | None = None
    resistances_ohm: Annotated[list[Resistance] | None, Field(min_length=3)] = None
    tolerance_percent: Annotated[float, Field(ge=0, lt=100)] = 0.1
    frames: Annotated[int, Field(ge=2, le=1000)] = 16
    gain_percent: Positive = 1.0
    reading_percent: Positive = 1.0
    noise_ppm: Positive = 1000.0
    offset_mV: Positive = 1.0
    lead_ohm: Positive = 100.0

    def problems(self) -> Iterator[Problem]:
        """One resistance for all, or one each."""
        if (self.resistance_ohm is None) == (self.resistances_ohm is None):
            finding = "needs either resistance_ohm, alike for all resistors, or resistances_ohm, one for each"
            yield Problem(("reference_ring",), finding)

    def to_domain(self) -> ReferenceRing:
        common_ohm = () if self.resistance_ohm is None else (self.resistance_ohm,)
        return as_domain(
            ReferenceRing,
            self,
            resistance_ohm=tuple(self.resistances_ohm or common_ohm),
            noise=self.noise_ppm / 1e6,
            offset_V=self.offset_mV / 1000,
        )


class CalibrationsTable(Table):
    """``[calibrations]``: how the station issues calibrations."""

    signing_key: Annotated[str, Field(min_length=1)]

    def problems(self) -> Iterator[Problem]:
        """The path must be a full one: a run is resumed from the database, wherever its station file was."""
        if not Path(self.signing_key).is_absolute() or "\0" in self.signing_key:
            yield Problem(("calibrations", "signing_key"), "is not a full path", "give one that begins with /")


class InstrumentTable(OpenTable):
    """``[instruments.<role>]``: driver, provided role, expected identity, and the driver's options."""

    driver: Name
    provides: Annotated[list[Word], Field(min_length=1)]
    model: Name | None = None
    serial: Name | None = None
    calibration_due: IsoDate | None = None

    def to_domain(self, role: str) -> InstrumentSpec:
        identity = {"model": self.model or "", "serial": self.serial or ""}
        return as_domain(InstrumentSpec, self, role=role, options=self.options, **identity)


class EventsTable(OpenTable):
    """``[events.<name>]``: a sink of events, and its options."""

    sink: Name

    def to_domain(self, name: str) -> EventSinkSpec:
        return EventSinkSpec(name, PluginChoice(self.sink, self.options))


class SyncTable(Table):
    """``[sync]``: the central database, and how long something may wait for it."""

    centre: Annotated[str, Field(max_length=500)] = ""
    backlog_hours: Annotated[float, Field(gt=0, le=87600)] | None = None

    def problems(self) -> Iterator[Problem]:
        path = ("sync", "centre")
        if self.centre and "://" not in self.centre:
            yield Problem(path, f"{self.centre!r} is no URL", "e.g. postgresql://station@10.0.0.5/quality")
        if "password=" in self.centre or ":" in self.centre.partition("://")[2].rpartition("@")[0]:
            yield Problem(path, "has a password in it, which would be stored with every run", "put it into ~/.pgpass")


Line = Annotated[
    str,
    Field(
        min_length=1,
        max_length=80,
        pattern=r"^\S+(?: \S+)*$",
        description="one line of 1 to 80 characters, with single blanks between its words",
    ),
    PRINTABLE,
]


class CertificateTable(Table):
    """``[certificate]``: what calibration certificates state of the laboratory and of its decision rule."""

    laboratory: Line
    prefix: Annotated[
        str,
        Field(
            pattern=r"^[A-Z0-9][A-Z0-9.-]{0,23}$",
            description="1 to 24 of A to Z, digits, . and -, starting with a letter or a digit",
        ),
    ]
    street: Line
    post_code: Line
    city: Line
    country: Annotated[
        str, Field(pattern=r"^[A-Z]{2}$", description='two letters A to Z, the code of ISO 3166-1: "DE" for Germany')
    ]
    email: Annotated[
        Annotated[str, Field(max_length=80, pattern=r"^[^@\s]+@[^@\s]+\.[^@\s.]+$"), PRINTABLE] | None,
        Field(description="an address of at most 80 characters, like office@example.org"),
    ] = None
    place: Line
    performed_at: Literal["laboratory", "laboratoryBranch", "customer", "customerBranch", "other"]
    signatory: Line
    function: Line
    validity_months: Annotated[int, Field(ge=1, le=round(12 * IN_USE_YEARS))] | None = None
    max_error_N: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    max_error_percent: Annotated[float, Field(ge=0, lt=100)] = 0.0
    decision: Literal["", "guarded", "simple"] = ""

    def problems(self) -> Iterator[Problem]:
        """A statement of conformity has a requirement that U can be within, and a decision rule."""
        for key, least, unit in (("max_error_N", 1e-6, "N"), ("max_error_percent", 1e-3, "%")):
            value = getattr(self, key)
            if 0 < value < least:
                finding = f"is {value:g} {unit}, less than any U of a force"
                yield Problem(("certificate", key), finding, f"allowed: 0, or at least {least:g} {unit}")
        if bool(self.decision) is not (self.max_error_N > 0 or self.max_error_percent > 0):
            finding = "and the maximum permissible error (max_error_N, max_error_percent) are stated together"
            yield Problem(("certificate", "decision"), finding, 'give "guarded" or "simple", or leave out all three')


class CertificateFile(FileModel[CertificateSettings]):
    """A file with ``[certificate]``: by itself, or a station's, of which nothing else is looked at."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True, allow_inf_nan=False)

    certificate: CertificateTable

    def problems(self) -> Iterator[Problem]:
        yield from self.certificate.problems()

    def to_domain(self) -> CertificateSettings:
        return as_domain(CertificateSettings, self.certificate, max_error_percent=self.certificate.max_error_percent)


class StationFile(FileModel[Station]):
    """A station file."""

    #: Roles that must be filled.
    needed_roles: ClassVar[tuple[str, ...]] = NEEDED_ROLES

    station: StationTable
    indenter: IndenterTable
    motion: MotionTable
    safety: SafetyTable
    instruments: Annotated[dict[Word, InstrumentTable], Field(min_length=1)]
    emulation: EmulationTable | None = None
    reference_ring: ReferenceRingTable | None = None
    calibrations: CalibrationsTable | None = None
    gate: GateTable = Field(default_factory=GateTable)
    events: Annotated[dict[Word, EventsTable], Field(default_factory=dict)]
    sync: SyncTable = Field(default_factory=SyncTable)
    standards: StandardsTable = Field(default_factory=StandardsTable)
    certificate: CertificateTable | None = None

    @classmethod
    def choices(cls, data: Any) -> Iterator[Choice]:
        instruments = data.get("instruments")
        for role, table in instruments.items() if isinstance(instruments, Mapping) else ():
            yield from read_choice(
                Kind.INSTRUMENT, table, ("instruments", role), "driver", tuple(InstrumentTable.model_fields)
            )
        events = data.get("events")
        for name, table in events.items() if isinstance(events, Mapping) else ():
            yield from read_choice(Kind.SINK, table, ("events", name), "sink")

    def problems(self) -> Iterator[Problem]:
        """Every role is filled once, the head by one instrument; emulated instruments have a world."""
        yield from self.station.problems()
        yield from self.indenter.problems()
        yield from self.safety.problems()
        yield from self._emulation_problems()
        if self.reference_ring is not None:
            yield from self.reference_ring.problems()
        if self.calibrations is not None:
            yield from self.calibrations.problems()
        yield from self.gate.problems()
        yield from self.sync.problems()
        yield from self._find_certificate_problems()
        if self.gate.backlog not in (None, "off") and self.sync.backlog_hours is None:
            yield Problem(("gate", "backlog"), "needs backlog_hours in [sync]")
        if self.station.overdue is not None and self.gate.calibration_due is not None:
            finding = "is given beside station.overdue, its earlier spelling; give one of them"
            yield Problem(("gate", "calibration_due"), finding)
        instrument_by_role: dict[str, str] = {}
        for name, table in self.instruments.items():
            for role in table.provides:
                if role in instrument_by_role:
                    finding = f"names {role!r}, which instruments.{instrument_by_role[role]} already provides"
                    yield Problem(("instruments", name, "provides"), finding)
                instrument_by_role.setdefault(role, name)
        for role in self.needed_roles:
            if role not in instrument_by_role:
                yield Problem(("instruments",), f"has nothing that provides {role!r}; every run needs it")

    def _find_certificate_problems(self) -> Iterator[Problem]:
        if self.certificate is not None:
            yield from self.certificate.problems()
        if not any(problem.path[0] == "indenter" for problem in self.indenter.problems()):
            yield from self.standards.problems()
            yield from self.standards.size_problems(self._list_spans())
            yield from self.standards.head_problems(self.indenter.to_domain())
            yield from self.standards.temperature_problems(self.safety.temperature_C)
            provided = [role for table in self.instruments.values() for role in table.provides]
            options = {name: table.options.get("current_mA") for name, table in self.instruments.items()}
            currents_mA = {name: float(value) for name, value in options.items() if isinstance(value, int | float)}
            yield from self.standards.instrument_problems(provided, currents_mA)

    def _list_spans(self) -> dict[StandardRole, float]:
        """Return the widths of the station's ranges of force, place and temperature [N, mm, °C]."""
        spans = {StandardRole.LOAD_CELL: self.safety.force_N, StandardRole.STAGE: 2 * self.safety.travel_radius_mm}
        if self.safety.temperature_C is not None:
            lowest_C, highest_C = self.safety.temperature_C
            spans[StandardRole.THERMOMETER] = highest_C - lowest_C
        return spans

    def _emulation_problems(self) -> Iterator[Problem]:
        emulated_roles = [
            name for name, table in self.instruments.items() if table.options.get("address") == EMULATED
        ]
        if self.emulation is None:
            for name in emulated_roles:
                finding = f"is {EMULATED!r}, but the station has no [emulation] table to say in which scene"
                yield Problem(("instruments", name, "address"), finding)
        elif not emulated_roles:
            yield Problem(("emulation",), f"is given, but no instrument has address = {EMULATED!r}")

    def to_domain(self) -> Station:
        return as_domain(
            Station,
            self.station,
            indenter=self.indenter.to_domain(),
            motion=as_domain(
                Motion,
                self.motion,
                press_speed_mm_s=self.motion.press_speed_mm_per_min / 60,
                travel_speed_mm_s=self.motion.travel_speed_mm_per_min / 60,
            ),
            safety=self.safety.to_domain(),
            instruments=tuple(
                table.to_domain(name)
                for name, table in sorted(self.instruments.items())  # tables have no order in TOML
            ),
            emulated_scene=None if self.emulation is None else self.emulation.scene,
            reference_ring=None if self.reference_ring is None else self.reference_ring.to_domain(),
            signing_key=None if self.calibrations is None else Path(self.calibrations.signing_key),
            gate=self.gate.to_domain(self.station.overdue),
            sync=as_domain(SyncSettings, self.sync),
            standards=self.standards.to_domain(),
            certificate=None
            if self.certificate is None
            else CertificateFile(certificate=self.certificate).to_domain(),
            events=tuple(table.to_domain(name) for name, table in sorted(self.events.items())),
        )


class UnfinishedStationFile(StationFile):
    """A station file that may lack instruments: for checks of those that are there."""

    needed_roles = ()


def resolve_options(instrument: InstrumentSpec, near: Path | None) -> InstrumentSpec:
    """Turn references to files next to the station file into their full paths, so that a driver can open them."""
    options = dict(instrument.options)
    for key in REFERENCES:
        if isinstance(name := options.get(key), str) and (path := reference_path(name, near)):
            options[key] = str(path.resolve())
    return replace(instrument, options=options)
