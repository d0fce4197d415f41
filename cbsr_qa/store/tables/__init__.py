"""Tables of the database."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .gate import (
        GateAnswerRow as GateAnswerRow,
        ReleaseRow as ReleaseRow,
    )
    from .records import (
        FEW_LINKS as FEW_LINKS,
        MANY_LINKS as MANY_LINKS,
        ArchiveRow as ArchiveRow,
        ChartReferenceRow as ChartReferenceRow,
        ConfigurationChangeRow as ConfigurationChangeRow,
        LinkRow as LinkRow,
        StationCheckFramesRow as StationCheckFramesRow,
        StationCheckLineRow as StationCheckLineRow,
        StationCheckRow as StationCheckRow,
        VerdictOverrideRow as VerdictOverrideRow,
    )
    from .results import (
        AdoptionRow as AdoptionRow,
        AnalysisRow as AnalysisRow,
        BaselineRow as BaselineRow,
        CalibrationRow as CalibrationRow,
        FitParameterRow as FitParameterRow,
        ForceRow as ForceRow,
        MeasurementRow as MeasurementRow,
        OverlapBandRow as OverlapBandRow,
        ReanalysisRow as ReanalysisRow,
        RelaxationRow as RelaxationRow,
        SettlingRow as SettlingRow,
        WarningRow as WarningRow,
    )
    from .runs import (
        AttendanceRow as AttendanceRow,
        Base as Base,
        FrameBlockRow as FrameBlockRow,
        InstrumentRow as InstrumentRow,
        LoadRow as LoadRow,
        PhaseEndRow as PhaseEndRow,
        PhaseRow as PhaseRow,
        RunBegunRow as RunBegunRow,
        RunRow as RunRow,
        RunStateRow as RunStateRow,
        SampleBlockRow as SampleBlockRow,
        SensorRow as SensorRow,
        StepRow as StepRow,
        UnloadedMarkRow as UnloadedMarkRow,
    )
    from .sync import (
        OutboxRow as OutboxRow,
        SyncAcceptsRow as SyncAcceptsRow,
        SyncRefusalRow as SyncRefusalRow,
        SyncSettlementRow as SyncSettlementRow,
    )

door(__name__, __file__)
