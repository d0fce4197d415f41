"""A door that opens: what the lab that owns the thermometer wants to try on a scene."""

from cbsr_qa.domain import ConfigError


class RoomDraught:
    """The sheet cools while a door is open, and resists more.

    Parameters
    ----------
    cooler_K : by how much.
    resists_per_K : relative rise of all impedances.
    from_s, to_s : when the door is open.
    """

    needs = ()
    perturbs = "impedance"

    def __init__(self, setting, *, cooler_K, resists_per_K, from_s, to_s):
        if not cooler_K >= 0:
            raise ConfigError(f"cooler_K is {cooler_K!r}", remedy="it is a finite number of at least 0")
        self._factor = 1 + resists_per_K * cooler_K
        self._from_s, self._to_s = from_s, to_s

    def apply(self, moment):
        """Scale what the electrodes see."""
        if self._from_s <= moment.time_s < self._to_s:
            moment.impedance_ohm = self._factor * moment.impedance_ohm
