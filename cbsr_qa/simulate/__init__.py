"""The simulated world: scenes, effects, addressed random streams."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .chain import (
        NOT_MODELLED as NOT_MODELLED,
        STAGES as STAGES,
        EffectFactory as EffectFactory,
        build_chain as build_chain,
    )
    from .effect import (
        Amount as Amount,
        Electrode as Electrode,
        Positive as Positive,
        SceneEffect as SceneEffect,
        check_at_most as check_at_most,
        check_electrode as check_electrode,
    )
    from .frames import SimulatedFrame as SimulatedFrame
    from .head import SimulatedHead as SimulatedHead
    from .ramps import (
        CONTACT_STRAIN as CONTACT_STRAIN,
        Transients as Transients,
        quasi_static as quasi_static,
        transient as transient,
    )
    from .recording import (
        SAMPLE_RATE_HZ as SAMPLE_RATE_HZ,
        PressedLoad as PressedLoad,
        RecordedScene as RecordedScene,
        planned_middles_s as planned_middles_s,
        press_loads as press_loads,
        record_scene as record_scene,
    )
    from .sheet import SimulatedSheet as SimulatedSheet, finest_mesh_mm as finest_mesh_mm
    from .streams import RandomStream as RandomStream, StepAddresses as StepAddresses
    from .world import SimulatedWorld as SimulatedWorld

door(__name__, __file__)
