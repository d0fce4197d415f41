"""Results: measurements, images, relaxations, calibrations, report content."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import calibration as calibration
    from .calibration import (
        BaselineConductance as BaselineConductance,
        Calibration as Calibration,
        ForceModel as ForceModel,
        Lattice as Lattice,
        LoadRelaxation as LoadRelaxation,
        OverlapBand as OverlapBand,
        SettlingSummary as SettlingSummary,
        Validity as Validity,
        VerifiedFile as VerifiedFile,
    )
    from .characterisation import (
        STRIP_MEASURES as STRIP_MEASURES,
        Characterisation as Characterisation,
        CharacterisationSettings as CharacterisationSettings,
        CycleChange as CycleChange,
        CycleReadings as CycleReadings,
        FittedLine as FittedLine,
        StrainLevel as StrainLevel,
        StrainSettling as StrainSettling,
        StripFacts as StripFacts,
    )
    from .dimensions import Dimensions as Dimensions
    from .fleet import (
        FleetTable as FleetTable,
        MetricKey as MetricKey,
        RunFigure as RunFigure,
        RunLine as RunLine,
        RunSelection as RunSelection,
        State as State,
        ValueKind as ValueKind,
    )
    from .image import (
        Blob as Blob,
        Image as Image,
        ImagingProblem as ImagingProblem,
        LinearReconstruction as LinearReconstruction,
        ParameterAnswer as ParameterAnswer,
        ParameterChoice as ParameterChoice,
        ParameterCurve as ParameterCurve,
        PreparedReconstruction as PreparedReconstruction,
        Region as Region,
        checked_readings as checked_readings,
        linear as linear,
    )
    from .learned_place import (
        MOST_PRESSES as MOST_PRESSES,
        FeatureScaling as FeatureScaling,
        LearnedPlace as LearnedPlace,
        ModelledPlace as ModelledPlace,
        PatternTurns as PatternTurns,
        PlaceMixture as PlaceMixture,
        PlaceOfRun as PlaceOfRun,
        PlaceProcess as PlaceProcess,
        PlaceScales as PlaceScales,
        PlaceTemplates as PlaceTemplates,
    )
    from .learned_quantity import LearnedQuantity as LearnedQuantity, QuantityScales as QuantityScales
    from .listed import ALTERED as ALTERED, Decision as Decision, ListedRun as ListedRun
    from .measurement import (
        SEVERITY as SEVERITY,
        Bound as Bound,
        EndReason as EndReason,
        Limit as Limit,
        LimitsVersion as LimitsVersion,
        Measurement as Measurement,
        Outcome as Outcome,
        Verdict as Verdict,
        decide as decide,
        explained as explained,
        judged_words as judged_words,
        metric_words as metric_words,
        relative_margin as relative_margin,
        worst as worst,
    )
    from .observation import (
        Estimated as Estimated,
        LoadEstimate as LoadEstimate,
        LoadFinding as LoadFinding,
        LoadObservation as LoadObservation,
        LoopObservation as LoopObservation,
        MaskView as MaskView,
        MetricTimeline as MetricTimeline,
        RelaxationObservation as RelaxationObservation,
        RunObservation as RunObservation,
        Trace as Trace,
    )
    from .press_calibration import (
        PRESS_QUANTITIES as PRESS_QUANTITIES,
        LeftOutPress as LeftOutPress,
        PressCalibration as PressCalibration,
        SheetRegistration as SheetRegistration,
        SourceFile as SourceFile,
    )
    from .relaxation import (
        FitStatus as FitStatus,
        RelaxationFit as RelaxationFit,
        RelaxationKernel as RelaxationKernel,
        SettlingTime as SettlingTime,
        SteadyPrediction as SteadyPrediction,
    )
    from .report import (
        Banner as Banner,
        Block as Block,
        Cell as Cell,
        CommandOutcome as CommandOutcome,
        Figure as Figure,
        Page as Page,
        Paragraph as Paragraph,
        RunResult as RunResult,
        Section as Section,
        Table as Table,
    )
    from .signature import Signature as Signature, fingerprint as fingerprint
    from .standing import ResultState as ResultState

door(__name__, __file__)
