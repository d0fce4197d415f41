"""A head that does not press evenly."""

import numpy as np

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.scene import HeadRing, SceneSetting, SheetDesign
from cbsr_qa_plugins.effects._heads import check_nested

_RINGS = 10


class PressureProfile:
    """The head presses unevenly: the response follows a pressure that depends on the distance from its axis.

    1 on average. ``punch``: p = ½ (1 − ρ²)^(−½), of a rigid punch on an elastic half-space (Boussinesq);
    ``parabola``: p = 2 (1 − ρ²), of a domed one. In ten annuli of equal width with the exact mean pressure of each.

    Parameters
    ----------
    shape : ``"punch"`` or ``"parabola"``.
    """

    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, shape: str) -> None:
        if shape not in ("punch", "parabola"):
            raise ConfigError(f"shape is {shape!r}", remedy="it is 'punch' or 'parabola'")
        check_nested(setting.indenter)
        self._shape = shape

    def design(self, design: SheetDesign) -> None:
        """Put annuli in the place of each ring."""
        edges = np.linspace(0, 1, _RINGS + 1)
        inside = 1 - np.sqrt(1 - edges**2) if self._shape == "punch" else 2 * edges**2 - edges**4
        pressure = np.diff(inside) / np.diff(edges**2)
        weights = pressure - np.append(pressure[1:], 0.0)  # of whole heads: each holds all within it
        design.rings = tuple(
            HeadRing(ring.size * float(size), ring.weight * float(weight))
            for ring in design.rings
            for size, weight in zip(edges[1:], weights, strict=True)
        )
