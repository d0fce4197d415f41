"""A door that opens: what the lab that owns the thermometer wants to try on a scene."""

from typing import Annotated

from pydantic import Field

from cbsr_qa.plugin.options import PluginOptions
from cbsr_qa.simulate.effect import SceneEffect


class RoomDraught(SceneEffect):
    """The sheet cools while a door is open, and resists more.

    Parameters
    ----------
    cooler_K : by how much.
    resists_per_K : relative rise of all impedances.
    from_s, to_s : when the door is open.
    """

    class Options(PluginOptions):
        cooler_K: Annotated[float, Field(ge=0)]
        resists_per_K: float
        from_s: float
        to_s: float

    perturbs = "impedance"

    def apply(self, moment):
        """Scale what the electrodes see."""
        options = self.options
        if options.from_s <= moment.time_s < options.to_s:
            moment.impedance_ohm = (1 + options.resists_per_K * options.cooler_K) * moment.impedance_ohm
