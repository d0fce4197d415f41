"""What is asked of a check of a station: its options, its configuration, its ring."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.serials import validate_operator, validate_serial
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.plan import ReferenceRing
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.station.setup import configure

#: Shipped recipe of a golden sensor's run.
GOLDEN_RECIPE: Final = "golden-check"
#: Limits for a ring given only on the command line: those of an empty [reference_ring] table.
_RING_LIMITS: Final[Mapping[str, float]] = {
    "tolerance": 1e-3,
    "gain": 1e-2,
    "reading": 1e-2,
    "noise": 1e-3,
    "offset_V": 1e-3,
    "lead_ohm": 100.0,
}
_RING_FRAMES: Final = 16
#: Resistances that a station file may state.
_OHM: Final = (1e-3, 1e9)


@dataclass(frozen=True, slots=True)
class CheckRequest:
    """A check to make; see the options of ``cbsr-qa station check`` and ``station record``.

    Parameters
    ----------
    record : transcript to write of all that passes between drivers and instruments; must not exist.
    """

    station: str
    golden: str | None = None
    operator: str = ""
    ring_ohm: float | None = None
    ring: bool = True
    ring_connected: bool = False
    sensor_type: str | None = None
    material: str | None = None
    seed: int = 0
    database: str | None = None
    record: Path | None = None


def load_configuration(request: CheckRequest, plugins: Plugins) -> Configuration:
    """Read what a request names.

    Raises
    ------
    ConfigError
        If a file or a name is wrong.
    """
    validate_operator(request.operator)
    if request.golden is not None:
        validate_serial(request.golden)
    return configure(
        request.station,
        GOLDEN_RECIPE,
        sensor_type=request.sensor_type,
        material=request.material,
        seed=request.seed,
        plugins=plugins,
        unfinished=request.golden is None,
    )


def choose_ring(request: CheckRequest, stated: ReferenceRing | None) -> ReferenceRing | None:
    """Return the station file's ring, with the resistance of the command line if given."""
    ohm = request.ring_ohm
    if not request.ring:
        if ohm is not None:
            raise RefusedError("--ring-ohm is given beside --no-ring", remedy="leave one of them out")
        return None
    if ohm is None:
        return stated
    if not _OHM[0] <= ohm <= _OHM[1]:
        raise RefusedError(f"--ring-ohm is {ohm:g}", remedy=f"a resistor has {_OHM[0]:g} to {_OHM[1]:g} ohm")
    if stated is not None:
        return replace(stated, resistance_ohm=(ohm,))
    return ReferenceRing((ohm,), frames=_RING_FRAMES, **_RING_LIMITS)


def refuse_both(request: CheckRequest, ring: ReferenceRing | None, simulated: bool) -> None:
    """Raise RefusedError if a ring and a golden sensor are both to be connected already, on a real bench."""
    if request.golden and ring is not None and request.ring_connected and not simulated:
        raise RefusedError(
            "the reference ring and a golden sensor cannot both be connected",
            remedy="leave out --ring-connected and be asked for each, or check the golden sensor with --no-ring",
        )
