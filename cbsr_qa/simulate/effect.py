"""What effects of a scene have in common: options that are read before anything is simulated."""

from typing import Annotated, Any, ClassVar, Final

from pydantic import Field

from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import SceneSetting
from cbsr_qa.plugin import PluginOptions

#: Beyond any quantity of a scene: its square is still a number, and so is its ratio to the smallest that counts.
BEYOND: Final = 1e15

Amount = Annotated[float, Field(ge=0, le=BEYOND)]
Positive = Annotated[float, Field(gt=0, le=BEYOND)]
Electrode = Annotated[int, Field(ge=0, le=10**6, description="the number of an electrode, from 0")]


class SceneEffect:
    """An effect that is made of its options and the scene's setting.

    Subclasses say what they perturb, and have the method of that stage (``apply``, ``design`` or ``record``).
    ConfigError naming every option that is unknown, missing or wrong, or does not fit the setting. ``options``: as of
    the class's own ``Options``; without one there are none.
    """

    Options: ClassVar[type[PluginOptions]] = PluginOptions
    #: Effects that must be on and come before this one, and those that come before it where they are on.
    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    options: PluginOptions

    def __init__(self, setting: SceneSetting, **options: Any) -> None:
        self.options = self.Options.read(options)
        self.prepare(setting)

    def prepare(self, setting: SceneSetting) -> None:
        """Compute what no moment changes; ConfigError for options that do not fit the setting."""


def check_at_most(name: str, value: float, most: float, why: str) -> None:
    """Refuse an option that is too large for the scene it is used in. ConfigError naming option, value and limit."""
    if value > most:
        raise ConfigError(f"{name} is {value}", remedy=f"it must be at most {most:g}: {why}")


def check_electrode(name: str, value: int, setting: SceneSetting) -> None:
    """Refuse an electrode that the sensor type does not have (ConfigError)."""
    last = setting.sensor_type.electrodes.count - 1
    if value > last:
        raise ConfigError(f"{name} is {value}", remedy=f"electrodes are numbered from 0 to {last}")
