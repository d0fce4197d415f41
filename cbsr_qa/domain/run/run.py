"""Runs: their identity, the stored record, and the state of its chain of digests."""

from dataclasses import dataclass, field
from datetime import datetime
from typing import Final, Literal

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.readings.loads import Indenter, LoadRecord
from cbsr_qa.domain.run.attendance import AskedPrompt, Pause
from cbsr_qa.domain.run.gate import GateAnswer
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import Material, SensorIdentity, SensorPart, SensorType

_NONE: Final = "no chain: it was removed; changes cannot be detected"


@dataclass(frozen=True, slots=True)
class ChainState:
    """State of a run's chain after verification; a broken chain is refused instead.

    Parameters
    ----------
    key_id : identifies the signing key without revealing it; None if unsigned.
    """

    state: Literal["unchained", "chained"] = "unchained"
    signature: Literal["none", "checked", "not checked"] = "none"
    key_id: str | None = None

    @property
    def chained(self) -> bool:
        """Whether changed rows of the run would be noticed."""
        return self.state == "chained"

    @property
    def words(self) -> str:
        if not self.chained:
            return _NONE
        if self.signature == "none":
            return "chained by digests, not signed"
        if self.signature == "checked":
            return f"chained by digests and signed (key {self.key_id})"
        return f"chained by digests; signatures not checked: key {self.key_id} is not set here"

    @property
    def label(self) -> str:
        """The state in a list: ``unchained``, ``chained``, ``signed`` or ``signature not checked``."""
        signed = {"none": self.state, "checked": "signed", "not checked": "signature not checked"}
        return signed[self.signature]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the run: rows without verification."""
        return () if self.chained else (f"rows of this run: {self.words}",)


#: State of a run whose chain was removed.
UNCHAINED: Final = ChainState()


@dataclass(frozen=True, slots=True)
class InstrumentIdentity:
    """Identity reported by an instrument.

    Parameters
    ----------
    role : role in the station file.
    driver : name of the plugin.
    model, serial, firmware : identity as the instrument reports it.
    simulated : whether no real instrument is behind it.
    calibration_due : ISO date; None if not stated.
    notes : further facts that trace it, as (what, value) in words: its address, a tare, a dead-weight check.
    """

    role: str
    driver: str
    model: str
    serial: str
    firmware: str
    simulated: bool
    calibration_due: str | None = None
    notes: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class RunIdentity:
    """Identity of a run: everything needed to trace it.

    Parameters
    ----------
    run : time-ordered UUID as text.
    sensor : serial, batch and type.
    station, recipe, operator : names; the operator may be empty.
    started_at : wall clock, with time zone.
    configuration_digest : SHA-256 of the merged configuration.
    software : distribution name → version, of this package, its plugins and its numerical libraries.
    instruments : instruments on the bench.
    simulated : simulated parts in words; empty for a real bench.
    parts : parts of the sensor, each name once, sorted by name.
    """

    run: str
    sensor: SensorIdentity
    station: str
    recipe: str
    operator: str
    started_at: datetime
    configuration_digest: str
    software: tuple[tuple[str, str], ...]
    instruments: tuple[InstrumentIdentity, ...]
    simulated: tuple[str, ...] = ()
    parts: tuple[SensorPart, ...] = ()

    @property
    def words(self) -> str:
        """The run as people name it: see :func:`run_named`."""
        return run_named(self.sensor.serial, self.started_at, self.run)


def run_named(serial: str, started_at: datetime | None, run: str) -> str:
    """Name a run as people do, by sensor and local date, with the identifier that commands take.

    Parameters
    ----------
    started_at : None if unknown.
    """
    if started_at is None:
        return f"{serial} ({run})"
    local_start = started_at.astimezone()
    return f"{serial}, {local_start:%Y-%m-%d %H:%M} {local_start.tzname()} ({run})"


@dataclass(frozen=True, slots=True)
class PhaseRecord:
    """One sequence of a run, as executed.

    Parameters
    ----------
    index, name, sequence : order, the recipe's name for it, the plugin that made its steps.
    started_s, ended_s : start and end on the run's clock [s].
    frames : every frame of the phase, or None.
    samples : joined blocks, one per channel.
    loads : the presses held to their end, but for loops: one press is one strain.
    loops : the presses that were eased to other strains before the release (see ``StrainStep``), as they were.
    unloaded_from_s : time from which the sheet counted as rested (see ``MarkUnloaded``), or None.
    role : stated purpose of the sequence (see ``Role``), or OTHER.
    """

    index: int
    name: str
    sequence: str
    started_s: float
    ended_s: float
    frames: FrameBlock | None
    samples: tuple[SampleBlock, ...] = ()
    loads: tuple[LoadRecord, ...] = ()
    unloaded_from_s: float | None = None
    role: Role = Role.OTHER
    loops: tuple[LoadRecord, ...] = ()

    def channel(self, name: str) -> SampleBlock | None:
        """Return the samples of a channel, or None if it was not recorded."""
        return next((block for block in self.samples if block.channel == name), None)


@dataclass(frozen=True, slots=True)
class RunSession:
    """One session of a run, from start or resumption to its end or interruption.

    Parameters
    ----------
    started_s, ended_s : start and end on the run's time line [s]; no end if interrupted.
    end, detail : end of the session, and its details; RUNNING if interrupted.
    operator, software : operator and software of its start or resumption; empty if not recorded.
    noted_at : time by the wall clock, for people; None if not recorded.
    """

    started_s: float
    ended_s: float | None
    end: EndReason
    detail: str = ""
    operator: str = ""
    software: tuple[tuple[str, str], ...] = ()
    noted_at: datetime | None = None


@dataclass(frozen=True, slots=True)
class PressDecided:
    """What was decided after some presses of a phase: which one is next, or that the phase ends.

    ``pressed`` counts the phase's presses so far. ``load``, ``label``, ``x_mm`` and ``y_mm`` are the next press; None
    and empty at the end. ``expected_N`` is the expected force error of what was learned so far, ``upper_N`` its upper
    bound, over the loads that matter, and ``floor_N`` what would remain if the map were known; None if nothing could
    be learned yet. ``why`` is ``start``, ``error``,
    ``target`` (it ends: the bound is at or below the target) or ``most presses`` (it ends).
    """

    type: Literal["press_decided"] = field(default="press_decided", kw_only=True, repr=False)
    phase: int
    pressed: int
    load: int | None
    label: str
    x_mm: float | None
    y_mm: float | None
    expected_N: float | None
    upper_N: float | None
    floor_N: float | None
    why: str
    time_s: float

    @property
    def ends(self) -> bool:
        return self.load is None

    @property
    def end_words(self) -> str:
        """The end of a phase for people, with the error that was reached."""
        why = "the target was reached" if self.why == "target" else "no more presses were allowed"
        if self.expected_N is None or self.upper_N is None or self.floor_N is None:
            return f"{why}; nothing could be learned about the force"
        words = (
            f"{why}: with the recipe's confidence the force error is at most {self.upper_N:.3g} N;"
            f" {self.expected_N:.3g} N is expected, to which large errors that are unlikely add"
        )
        return words if self.why == "target" else f"{words}; {self.floor_N:.3g} N remain however many presses"


@dataclass(frozen=True, slots=True)
class RunRecord:
    """A whole run, the only input of its analysis.

    Parameters
    ----------
    identity, sensor_type, material, indenter : run, sensor type, material and head of the test.
    phases : phases in the order they were run.
    end : reason why it ended.
    end_detail : person who aborted it, or rule or instrument that broke it.
    station_s : time the sensor occupied the station [s].
    sessions : sessions in order; one where the run was not interrupted.
    set_aside : frames that are stored and do not count: a load that was cut off was pressed again.
    pauses, prompts : pauses and prompts in the order they began.
    chain : state of the digests it is under, checked when it was loaded.
    gate : answers of the checks before the run, and of those asked again when it was resumed.
    chain_head : digest of the last link that was checked then; empty where the run has no chain.
    decisions : what was decided between presses of a sequence that decides, in order.
    """

    identity: RunIdentity
    sensor_type: SensorType
    material: Material
    indenter: Indenter
    phases: tuple[PhaseRecord, ...]
    end: EndReason
    end_detail: str = ""
    station_s: float = 0.0
    spent: tuple[tuple[str, float], ...] = field(default=())  #: station seconds by kind of step
    sessions: tuple[RunSession, ...] = field(default=())
    set_aside: int = 0
    pauses: tuple[Pause, ...] = field(default=())
    prompts: tuple[AskedPrompt, ...] = field(default=())
    chain: ChainState = field(default_factory=ChainState)
    gate: tuple[GateAnswer, ...] = ()
    chain_head: str = field(default="", compare=False)
    decisions: tuple[PressDecided, ...] = ()

    @property
    def presses(self) -> int:
        """Number of presses of all phases."""
        return sum(len(phase.loads) + len(phase.loops) for phase in self.phases)

    @property
    def error_by_minute(self) -> tuple[tuple[float, float], ...]:
        """Station time [min] and expected force error [N] at each decision between presses."""
        known = [(made.time_s, made.expected_N) for made in self.decisions if made.expected_N is not None]
        return tuple((round(time_s / 60, 3), float(f"{error_N:.4g}")) for time_s, error_N in known)

    def phase(self, name: str) -> PhaseRecord:
        """Return a phase by its name in the recipe.

        Raises
        ------
        RefusedError
            If the run has no such phase.
        """
        for phase in self.phases:
            if phase.name == name:
                return phase
        known_phases = ", ".join(phase.name for phase in self.phases) or "none"
        raise RefusedError(f"run {self.identity.run} has no phase {name!r}; phases: {known_phases}")
