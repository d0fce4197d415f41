"""Scenes: explanation, costs and recordings."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .explain import Explained as Explained, explain_scene as explain_scene
    from .report import explained_outcome as explained_outcome, scene_outcome as scene_outcome
    from .run import (
        SceneRun as SceneRun,
        SceneRunRequest as SceneRunRequest,
        SimulatedScene as SimulatedScene,
        run_scene as run_scene,
        simulate_to_memory as simulate_to_memory,
    )
    from .setting import (
        SceneSetup as SceneSetup,
        made_world as made_world,
        set_up as set_up,
    )

door(__name__, __file__)
