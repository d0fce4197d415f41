"""Runs as recorded: events, loads, changes, station checks."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .attendance import (
        AskedPrompt as AskedPrompt,
        AttendanceEvent as AttendanceEvent,
        Pause as Pause,
        PromptAnswered as PromptAnswered,
        PromptShown as PromptShown,
        RunContinued as RunContinued,
        RunPaused as RunPaused,
        pauses_of as pauses_of,
        prompts_of as prompts_of,
    )
    from .changes import (
        NO_REASON as NO_REASON,
        ChangeHistory as ChangeHistory,
        ConfigurationChange as ConfigurationChange,
        Difference as Difference,
        EarlierRun as EarlierRun,
        FileKind as FileKind,
        SensorHistory as SensorHistory,
        VerdictOverride as VerdictOverride,
        differences as differences,
    )
    from .event_documents import (
        EventMessage as EventMessage,
        event_document as event_document,
        event_message as event_message,
    )
    from .gate import (
        GateAnswer as GateAnswer,
        GateOutcome as GateOutcome,
        Release as Release,
        gate_warnings as gate_warnings,
    )
    from .loads import (
        NINE_LOCATIONS_MM as NINE_LOCATIONS_MM,
        EasedStrain as EasedStrain,
        HeldStrain as HeldStrain,
        Indenter as Indenter,
        Load as Load,
        LoadRecord as LoadRecord,
    )
    from .run import (
        UNCHAINED as UNCHAINED,
        ChainState as ChainState,
        FramesTaken as FramesTaken,
        InstrumentIdentity as InstrumentIdentity,
        LoadFinished as LoadFinished,
        PhaseFinished as PhaseFinished,
        PhaseRecord as PhaseRecord,
        PhaseStarted as PhaseStarted,
        RunConcluded as RunConcluded,
        RunEnded as RunEnded,
        RunEvent as RunEvent,
        RunIdentity as RunIdentity,
        RunRecord as RunRecord,
        RunSession as RunSession,
        RunStarted as RunStarted,
        SamplesTaken as SamplesTaken,
        StepRetried as StepRetried,
        StepStarted as StepStarted,
        Unloaded as Unloaded,
        run_named as run_named,
    )
    from .station import (
        ChartKind as ChartKind,
        ChartReference as ChartReference,
        ChartSettings as ChartSettings,
        CheckOutcome as CheckOutcome,
        CheckResult as CheckResult,
        CheckSeal as CheckSeal,
        RingReadings as RingReadings,
        StandingSignal as StandingSignal,
        StationCharts as StationCharts,
        StationCheck as StationCheck,
        worst_check as worst_check,
    )

door(__name__, __file__)
