"""Base of a scene's effects: options are validated before anything is simulated."""

from typing import Annotated, Any, ClassVar, Final

from pydantic import Field

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.world import SceneSetting
from cbsr_qa.plugin.options import PluginOptions

#: Bound above any quantity of a scene: its square is still finite, and so is its ratio to the smallest relevant one.
BEYOND: Final = 1e15

Amount = Annotated[float, Field(ge=0, le=BEYOND)]
Positive = Annotated[float, Field(gt=0, le=BEYOND)]
Electrode = Annotated[int, Field(ge=0, le=10**6, description="the number of an electrode, from 0")]


class SceneEffect:
    """An effect created from its options and the scene's setting.

    Subclasses declare what they perturb, and have the method of that stage (``apply``, ``design`` or ``record``).
    ConfigError naming every option that is unknown, missing or wrong, or does not fit the setting. ``options``: those
    of the class's own ``Options``, if any.
    """

    Options: ClassVar[type[PluginOptions]] = PluginOptions
    #: Effects that must be enabled and come before this one, and those that come before it if they are enabled.
    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    options: PluginOptions

    def __init__(self, setting: SceneSetting, **options: Any) -> None:
        self.options = self.Options.read(options)
        self.prepare(setting)

    def prepare(self, setting: SceneSetting) -> None:
        """Compute what no moment changes; ConfigError for options that do not fit the setting."""


def check_at_most(name: str, value: float, most: float, why: str) -> None:
    """Refuse an option that is too large for its scene. ConfigError naming option, value and limit."""
    if value > most:
        raise ConfigError(f"{name} is {value}", remedy=f"it must be at most {most:g}: {why}")


def check_electrode(name: str, value: int, setting: SceneSetting) -> None:
    """Refuse an electrode that the sensor type lacks (ConfigError)."""
    last_number = setting.sensor_type.electrodes.count - 1
    if value > last_number:
        raise ConfigError(f"{name} is {value}", remedy=f"electrodes are numbered from 0 to {last_number}")
