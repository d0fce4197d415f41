"""The door for plugins: hooks, Protocols, instruments, and how plugins are found."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .discovery import (
        Factory as Factory,
        Plugins as Plugins,
        create_plugin as create_plugin,
        discover as discover,
        left_running as left_running,
    )
    from .failures import Interruption as Interruption, contained as contained, failure as failure, said as said
    from .hooks import Example as Example, Kind as Kind, Register as Register, Veto as Veto, hookimpl as hookimpl
    from .instruments import (
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
    from .interfaces import (
        AnyEffect as AnyEffect,
        Effect as Effect,
        EventSink as EventSink,
        LoadMetric as LoadMetric,
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
    from .options import (
        Array as Array,
        PluginOptions as PluginOptions,
        WholeNumber as WholeNumber,
        WithOptions as WithOptions,
        driver as driver,
        options_of as options_of,
    )
    from .problems import (
        CheckedTable as CheckedTable,
        Problem as Problem,
        Table as Table,
        check as check,
    )
    from .reference import (
        FailedPlugin as FailedPlugin,
        ListedPlugin as ListedPlugin,
        ListedPlugins as ListedPlugins,
        PluginReference as PluginReference,
        ShownPlugins as ShownPlugins,
        plugin_reference as plugin_reference,
        reference_page as reference_page,
    )
    from .software import (
        NOT_INSTALLED as NOT_INSTALLED,
        kind_named as kind_named,
        software_versions as software_versions,
    )
    from .words import KeyPath as KeyPath, dotted as dotted, echo as echo, printable as printable, shown as shown

door(__name__, __file__)
