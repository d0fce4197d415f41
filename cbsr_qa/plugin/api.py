"""What a plugin imports from :mod:`cbsr_qa.plugin`: hooks, Protocols, options, links, and words of the domain."""
# ruff: noqa: PLC0414 - "X as X" marks a re-export

from cbsr_qa.domain.errors import (
    CbsrError as CbsrError,
    ConfigError as ConfigError,
    DeliveryError as DeliveryError,
    InstrumentError as InstrumentError,
    NoMoreFramesError as NoMoreFramesError,
    NumericsError as NumericsError,
    PluginError as PluginError,
    RecordingError as RecordingError,
    RefusedError as RefusedError,
    RowProblem as RowProblem,
    SafetyError as SafetyError,
)
from cbsr_qa.domain.geometry.footprints import RoundFootprint as RoundFootprint
from cbsr_qa.domain.geometry.outlines import Disc as Disc, SheetOutline as SheetOutline
from cbsr_qa.domain.goodness import Goodness as Goodness
from cbsr_qa.domain.imaging import (
    Blob as Blob,
    Image as Image,
    ImagingProblem as ImagingProblem,
    LinearReconstruction as LinearReconstruction,
    ParameterAnswer as ParameterAnswer,
    ParameterChoice as ParameterChoice,
    ParameterCurve as ParameterCurve,
)
from cbsr_qa.domain.plan.limits import (
    SEVERITY as SEVERITY,
    Bound as Bound,
    LimitsVersion as LimitsVersion,
    Outcome as Outcome,
    worst as worst,
)
from cbsr_qa.domain.plan.plan import Motion as Motion, SafetyLimits as SafetyLimits
from cbsr_qa.domain.plan.steps import (
    CLEARANCE_MM as CLEARANCE_MM,
    LEAST_SPREAD_MM as LEAST_SPREAD_MM,
    SEARCH_CONTACT_STEPS as SEARCH_CONTACT_STEPS,
    SEARCH_DWELL_S as SEARCH_DWELL_S,
    SEARCH_FROM_MM as SEARCH_FROM_MM,
    SEARCH_STEP_MM as SEARCH_STEP_MM,
    AcquireFrames as AcquireFrames,
    FindSurface as FindSurface,
    Hold as Hold,
    LowerHover as LowerHover,
    MarkUnloaded as MarkUnloaded,
    Press as Press,
    Prompt as Prompt,
    Release as Release,
    Role as Role,
    Settle as Settle,
    Step as Step,
    StrainStep as StrainStep,
    TouchPlane as TouchPlane,
    spread_mm as spread_mm,
)
from cbsr_qa.domain.plan.world import (
    CONTACT_LENGTH_MM as CONTACT_LENGTH_MM,
    Dump as Dump,
    HeadRing as HeadRing,
    Moment as Moment,
    SceneSetting as SceneSetting,
    SheetDesign as SheetDesign,
    SheetField as SheetField,
    Transcript as Transcript,
)
from cbsr_qa.domain.readings.carry_over import correct_carry_over as correct_carry_over
from cbsr_qa.domain.readings.frames import (
    UNUSABLE as UNUSABLE,
    FrameBlock as FrameBlock,
    ReadingFlag as ReadingFlag,
    ReadOptions as ReadOptions,
    Recording as Recording,
    SampleBlock as SampleBlock,
    ScanKind as ScanKind,
    VoltageUnit as VoltageUnit,
    join_frames as join_frames,
)
from cbsr_qa.domain.readings.load_estimates import (
    Estimated as Estimated,
    LoadEstimate as LoadEstimate,
    LoadFinding as LoadFinding,
)
from cbsr_qa.domain.readings.loads import (
    NINE_LOCATIONS_MM as NINE_LOCATIONS_MM,
    Indenter as Indenter,
    Load as Load,
    LoadRecord as LoadRecord,
)
from cbsr_qa.domain.results.calibration import BaselineConductance as BaselineConductance, Calibration as Calibration
from cbsr_qa.domain.results.characterisation import (
    Characterisation as Characterisation,
    FittedLine as FittedLine,
    StrainLevel as StrainLevel,
    StrainSettling as StrainSettling,
)
from cbsr_qa.domain.results.dimensions import Dimensions as Dimensions
from cbsr_qa.domain.results.findings import (
    ImagedPlace as ImagedPlace,
    LoadEvent as LoadEvent,
    RecordingResult as RecordingResult,
)
from cbsr_qa.domain.results.measurement import (
    Measurement as Measurement,
    metric_words as metric_words,
    relative_margin as relative_margin,
)
from cbsr_qa.domain.results.observation import (
    LoadObservation as LoadObservation,
    MaskView as MaskView,
    MetricTimeline as MetricTimeline,
    RelaxationObservation as RelaxationObservation,
    RunObservation as RunObservation,
    Trace as Trace,
)
from cbsr_qa.domain.results.relaxation import FitStatus as FitStatus, RelaxationFit as RelaxationFit
from cbsr_qa.domain.results.report import (
    Block as Block,
    Cell as Cell,
    Figure as Figure,
    Paragraph as Paragraph,
    Table as Table,
)
from cbsr_qa.domain.results.run_result import RunResult as RunResult
from cbsr_qa.domain.run.changes import ChangeHistory as ChangeHistory, VerdictOverride as VerdictOverride
from cbsr_qa.domain.run.run import (
    InstrumentIdentity as InstrumentIdentity,
    PhaseRecord as PhaseRecord,
    RunRecord as RunRecord,
    RunSession as RunSession,
)
from cbsr_qa.domain.run.states import EndReason as EndReason
from cbsr_qa.domain.run.station import CheckOutcome as CheckOutcome, CheckResult as CheckResult
from cbsr_qa.domain.sensor.electrodes import (
    ElectrodeKind as ElectrodeKind,
    ElectrodeLayout as ElectrodeLayout,
    Electrodes as Electrodes,
    PlacedElectrodes as PlacedElectrodes,
)
from cbsr_qa.domain.sensor.mesh import Mesh as Mesh
from cbsr_qa.domain.sensor.patterns import (
    DrivePattern as DrivePattern,
    Pair as Pair,
    Pairs as Pairs,
    adjacent_pattern as adjacent_pattern,
)
from cbsr_qa.domain.sensor.sensor_type import Relaxation as Relaxation, SensorType as SensorType
from cbsr_qa.plugin.hooks import (
    Emulator as Emulator,
    Example as Example,
    Kind as Kind,
    Register as Register,
    Veto as Veto,
    hookimpl as hookimpl,
)
from cbsr_qa.plugin.instruments import (
    Addressed as Addressed,
    Alive as Alive,
    ForceApplicator as ForceApplicator,
    FrameSource as FrameSource,
    Instrument as Instrument,
    Linked as Linked,
    MeterReading as MeterReading,
    Multiplexer as Multiplexer,
    Sampler as Sampler,
    SelfTesting as SelfTesting,
    SourceMeter as SourceMeter,
    StationContext as StationContext,
)
from cbsr_qa.plugin.interfaces import (
    AdaptiveSequence as AdaptiveSequence,
    AnyEffect as AnyEffect,
    Effect as Effect,
    EventSink as EventSink,
    LoadMetric as LoadMetric,
    PressGoal as PressGoal,
    Reconstruction as Reconstruction,
    RecordingEffect as RecordingEffect,
    RecordingFormat as RecordingFormat,
    RecordingWriter as RecordingWriter,
    ReportSection as ReportSection,
    RunMetric as RunMetric,
    Sequence as Sequence,
    SequenceContext as SequenceContext,
    SheetEffect as SheetEffect,
    SwitchingEffect as SwitchingEffect,
)
from cbsr_qa.plugin.options import (
    Array as Array,
    PluginOptions as PluginOptions,
    WholeNumber as WholeNumber,
    WithOptions as WithOptions,
    driver as driver,
    options_of as options_of,
)
from cbsr_qa.plugin.problems import Problem as Problem
