from .explain import Explained as Explained, ExplainedEffect as ExplainedEffect, explain_scene as explain_scene
from .run import SceneRun as SceneRun, SceneRunRequest as SceneRunRequest, run_scene as run_scene
from .setting import SceneSetup as SceneSetup, effects_of as effects_of, made_world as made_world, set_up as set_up
