"""A station at work: bench, dry run, execution, safety."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .bench import (
        FORCE_APPLICATOR as FORCE_APPLICATOR,
        FORCE_CHANNEL as FORCE_CHANNEL,
        FRAME_SOURCE as FRAME_SOURCE,
        MULTIPLEXER as MULTIPLEXER,
        SOURCE_METER as SOURCE_METER,
        Action as Action,
        Bench as Bench,
        Mounted as Mounted,
        identity_of as identity_of,
        open_bench as open_bench,
        stop_all as stop_all,
    )
    from .documents import MemoryJournal as MemoryJournal
    from .dry_runs import DryRun as DryRun, dry_run as dry_run
    from .event_sinks import Delivery as Delivery, EventSinks as EventSinks
    from .execution import execute as execute
    from .interrupts import Interrupts as Interrupts, on_stderr as on_stderr
    from .limits import check_samplers as check_samplers, place_violations as place_violations
    from .plan import (
        LoadKey as LoadKey,
        Plan as Plan,
        PlannedPhase as PlannedPhase,
        ScheduledPhase as ScheduledPhase,
        ScheduledStep as ScheduledStep,
        describe as describe,
        schedule as schedule,
    )
    from .progress import RunProgress as RunProgress
    from .prompts import OperatorPrompt as OperatorPrompt
    from .setup import (
        check_clock as check_clock,
        configure as configure,
        open_instrument as open_instrument,
        open_station as open_station,
        opener as opener,
        plan_of as plan_of,
        station_clock as station_clock,
    )

door(__name__, __file__)
