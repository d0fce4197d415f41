"""What no effect of the simulated world models."""

from typing import Final

#: In words, for every scene; docs/explanation/simulation.md has what each effect leaves out by itself.
NOT_MODELLED: Final[tuple[str, ...]] = (
    "the third dimension of the sheet, and heating by the current",
    "capacitance: currents are direct",
    "conductance that depends on direction; steps, holes and cracks of the sheet",
    "a sheet that is bent, or that moves while it is pressed",
    "ageing of the material, and relaxation that depends on strain",
    "contacts that feel the head, or depend on the current",
    "stress that one load causes under another; slip under a head",
    "acceleration of the head; compliance and vibration of the frame",
    "drift, hysteresis and creep of the load cell",
    "noise that is correlated in time, and steps in noise",
)
