"""Plans: station, recipe, steps, scene."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import steps as steps
    from .gate import (
        GateCheck as GateCheck,
        GatePolicy as GatePolicy,
        GateSettings as GateSettings,
        Operator as Operator,
    )
    from .plan import (
        EMULATED as EMULATED,
        NO_RECONSTRUCTION as NO_RECONSTRUCTION,
        AnalysisSettings as AnalysisSettings,
        EventSinkSpec as EventSinkSpec,
        InstrumentSpec as InstrumentSpec,
        Motion as Motion,
        PhaseSpec as PhaseSpec,
        PluginChoice as PluginChoice,
        Recipe as Recipe,
        ReferenceRing as ReferenceRing,
        SafetyLimits as SafetyLimits,
        Scene as Scene,
        Station as Station,
        SyncSettings as SyncSettings,
    )
    from .scene_plan import (
        MOST_FRAMES as MOST_FRAMES,
        PressTimes as PressTimes,
        SceneLoad as SceneLoad,
        ScenePlan as ScenePlan,
        approach_s as approach_s,
        press_times as press_times,
        stroke_points as stroke_points,
    )
    from .steps import (
        CLEARANCE_MM as CLEARANCE_MM,
        SEARCH_CONTACT_STEPS as SEARCH_CONTACT_STEPS,
        SEARCH_DWELL_S as SEARCH_DWELL_S,
        SEARCH_FROM_MM as SEARCH_FROM_MM,
        SEARCH_STEP_MM as SEARCH_STEP_MM,
        AcquireFrames as AcquireFrames,
        FindSurface as FindSurface,
        Hold as Hold,
        Home as Home,
        MarkUnloaded as MarkUnloaded,
        Press as Press,
        Prompt as Prompt,
        Release as Release,
        Role as Role,
        Step as Step,
        StrainStep as StrainStep,
        distance_mm as distance_mm,
        stroke_s as stroke_s,
        surface_search_s as surface_search_s,
        travel_s as travel_s,
    )
    from .world import (
        CONTACT_LENGTH_MM as CONTACT_LENGTH_MM,
        Dump as Dump,
        HeadPosition as HeadPosition,
        HeadRing as HeadRing,
        Moment as Moment,
        SceneSetting as SceneSetting,
        SheetDesign as SheetDesign,
        SheetField as SheetField,
        SimulatedPress as SimulatedPress,
        StrainRamp as StrainRamp,
        Transcript as Transcript,
    )

door(__name__, __file__)
