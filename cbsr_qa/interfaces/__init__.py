"""What a plugin implements: small Protocols, one verb each where possible.

A factory registered under a kind (see :mod:`cbsr_qa.hookspecs`) is called with the options of the station,
recipe or scene file and returns an object with these methods. There is nothing to subclass.
"""

from cbsr_qa.interfaces.files import RecordingFormat, RecordingWriter, ReportSection
from cbsr_qa.interfaces.imaging import LoadMetric, Reconstruction, RunMetric
from cbsr_qa.interfaces.instruments import (
    Addressed,
    Alive,
    ForceApplicator,
    FrameSource,
    Instrument,
    Linked,
    MeterReading,
    Multiplexer,
    Sampler,
    SelfTesting,
    SourceMeter,
    StationContext,
)
from cbsr_qa.interfaces.scenes import AnyEffect, Effect, RecordingEffect, SheetEffect, SwitchingEffect
from cbsr_qa.interfaces.sequences import Sequence, SequenceContext

__all__ = [
    "Addressed",
    "Alive",
    "AnyEffect",
    "Effect",
    "ForceApplicator",
    "FrameSource",
    "Instrument",
    "Linked",
    "LoadMetric",
    "MeterReading",
    "Multiplexer",
    "Reconstruction",
    "RecordingEffect",
    "RecordingFormat",
    "RecordingWriter",
    "ReportSection",
    "RunMetric",
    "Sampler",
    "SelfTesting",
    "Sequence",
    "SequenceContext",
    "SheetEffect",
    "SourceMeter",
    "StationContext",
    "SwitchingEffect",
]
