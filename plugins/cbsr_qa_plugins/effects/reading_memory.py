"""Each reading keeps a share of the one before."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate.parameters import number


class ReadingMemory:
    """Each reading keeps a share of the one before it, as of a multiplexer and converter that do not settle.

    s[n] = (1 − m) x[n] + m s[n−1]. A frame begins with the memory of its own last reading, as if the one before had
    been the same: frames do not depend on each other. Where no reading differs by more than d from that of the frame
    before, reading n (from 0) is wrong by m^(n + 1) d at most.

    Parameters
    ----------
    share : m; recordings of the authors' board show 0.11 to 0.14.
    inner : which pair steps faster, ``"measure"`` or ``"drive"``. Where ``time-skew`` is on its order holds, which
        this may only repeat; by default that, or ``"measure"`` where all readings are taken at once.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("voltmeter-input",)
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, share: float, inner: str | None = None) -> None:
        if inner is not None and inner not in ("measure", "drive"):
            raise ConfigError(f"inner is {inner!r}", remedy="it is 'measure' or 'drive'")
        self._share = number("share", share, most=0.9)
        self._inner = inner
        self._shares: NDArray[np.float64] | None = None

    def apply(self, moment: Moment) -> None:
        """Mix the readings in their order."""
        if moment.voltages is None:
            return
        turned = self._order(moment) == "drive"
        frame = moment.voltages.T if turned else moment.voltages
        mixed = (self._mixed(frame.size) @ frame.ravel()).reshape(frame.shape)
        moment.voltages = mixed.T if turned else mixed

    def _order(self, moment: Moment) -> str:
        """Which pair steps faster."""
        at_s = moment.reading_offsets_s
        if at_s is None or min(at_s.shape) < 2:
            return self._inner or "measure"
        told = "drive" if at_s[1, 0] < at_s[0, 1] else "measure"
        if self._inner not in (told, None) and at_s[1, 0] != at_s[0, 1]:
            raise RefusedError(
                f"reading-memory has inner = {self._inner!r}, while time-skew steps the {told!r} pair faster",
                remedy="give both the same inner, or leave it out of reading-memory",
            )
        return told if at_s[1, 0] != at_s[0, 1] else self._inner or "measure"

    def _mixed(self, count: int) -> NDArray[np.float64]:
        """Shares of the readings x in the readings s, (n, n): the inverse of 1 − m (one back, the first the last)."""
        if self._shares is None or len(self._shares) != count:
            kept, back = self._share, np.subtract.outer(np.arange(count), np.arange(count)) % count
            self._shares = (1 - kept) * kept**back / (1 - kept**count)
        return self._shares
