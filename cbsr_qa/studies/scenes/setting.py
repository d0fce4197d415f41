"""Files of a scene and the world they define, shared by the scene commands."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cbsr_qa.config.loader import Loaded, load_material, load_scene_plan, load_sensor_type
from cbsr_qa.config.scene_checks import check_plan
from cbsr_qa.domain.errors import CbsrError, ConfigError
from cbsr_qa.domain.plan.scene_plan import ScenePlan
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.simulate.chain import EffectFactory
from cbsr_qa.simulate.sheet import SimulatedSheet
from cbsr_qa.simulate.world import SimulatedWorld

#: Sensor and material used to explain a scene that leaves them to a station.
USUAL_SENSOR_TYPE, USUAL_MATERIAL = "disc-100mm", "cbsr-8wt"

#: Optional parts of a scene that a recording needs → the complaint, and the lines to add.
_LACKING = {
    "sensor": ("what to simulate", f'[sensor]\nsensor_type = "{USUAL_SENSOR_TYPE}"\nmaterial = "{USUAL_MATERIAL}"'),
    "recording": ("for how long", "[recording]\nseed = 7\nduration_s = 60.0"),
}


@dataclass(frozen=True, slots=True, eq=False)
class SceneSetup:
    """A scene with the files it names.

    Parameters
    ----------
    loaded : the scene's plan and document.
    sensor_type, material : simulated ones.
    """

    loaded: Loaded[ScenePlan]
    sensor_type: Loaded[SensorType]
    material: Loaded[Material]

    @property
    def plan(self) -> ScenePlan:
        """Content of the scene's file."""
        return self.loaded.value

    @property
    def label(self) -> str:
        """Name of the scene in messages."""
        return self.loaded.document.label


def set_up(scene: str, plugins: Plugins | None = None, *, recorded: bool) -> SceneSetup:
    """Open a scene's files and check its loads.

    Parameters
    ----------
    scene : path or shipped name.
    plugins : plugins that check the parameters of effects, with the rest of the file.
    recorded : whether the scene must state what is simulated and recorded; otherwise the usual sensor is used.

    Raises
    ------
    ConfigError
        If a file is missing or wrong, a load cannot be pressed, or the scene does not state what is recorded.
    """
    loaded = load_scene_plan(scene, plugins)
    if recorded:
        _check_complete(loaded)
    plan, folder = loaded.value, loaded.folder
    with name_scene_file(loaded.document.label):
        sensor_type = load_sensor_type(plan.sensor_type or USUAL_SENSOR_TYPE, near=folder)
        material = load_material(plan.material or USUAL_MATERIAL, near=folder)
    check_plan(loaded, sensor_type.value)
    return SceneSetup(loaded, sensor_type, material)


def _check_complete(loaded: Loaded[ScenePlan]) -> None:
    is_given = {"sensor": loaded.value.sensor_type is not None, "recording": loaded.value.duration_s is not None}
    lacking = [table for table, given in is_given.items() if not given]
    if lacking:
        table_names = " and no ".join(f"[{table}]" for table in lacking)
        unsaid = " and ".join(_LACKING[table][0] for table in lacking)
        lines = "\n".join(_LACKING[table][1] for table in lacking)
        raise ConfigError(
            f"{loaded.document.label} has no {table_names}: it does not state {unsaid}",
            remedy=f"add lines like these, before or after its other tables:\n{lines}",
        )


def make_world(
    setup: SceneSetup,
    effect_factory: EffectFactory,
    *,
    seed: int,
    plan: ScenePlan | None = None,
    sheet: SimulatedSheet | None = None,
) -> SimulatedWorld:
    """Make a scene's world.

    Parameters
    ----------
    plan : instead of the setup's own.
    sheet : see :class:`~cbsr_qa.simulate.world.SimulatedWorld`.

    Raises
    ------
    ConfigError
        If its effects do not fit together, with the scene's file.
    """
    chosen_plan = setup.plan if plan is None else plan
    with name_scene_file(setup.label):
        return SimulatedWorld(
            chosen_plan.scene,
            setup.sensor_type.value,
            setup.material.value,
            chosen_plan.indenter,
            seed=seed,
            effect_factory=effect_factory,
            sheet=sheet,
        )


@contextmanager
def name_scene_file(label: str) -> Iterator[None]:
    """Put the name of the scene's file before every refusal."""
    try:
        yield
    except CbsrError as error:
        raise ConfigError(f"{label}: {error.reason}", remedy=error.remedy) from error
