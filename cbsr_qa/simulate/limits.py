"""What no effect of the simulated world models."""

from typing import Final

#: In words, for every scene; docs/explanation/simulation.md has what each effect leaves out by itself.
NOT_MODELLED: Final[tuple[str, ...]] = (
    "the third dimension of the sheet, and heating by the current",
    "conductance that depends on direction; steps, holes and cracks of the sheet",
    "a sheet that is bent, or that moves while it is pressed",
    "ageing of the material, and relaxation that depends on strain",
    "stress that one load or one head causes under another; slip and friction under a head",
    "acceleration of the head, and compliance of the frame",
    "drift and hysteresis of the load cell",
)
