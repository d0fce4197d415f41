"""Each reading keeps a share of the one before."""

import numpy as np
from scipy.signal import lfilter

from cbsr_qa.domain.errors import ConfigError
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
    inner : which pair steps faster, ``"measure"`` or ``"drive"``; as of ``time-skew`` where that is on.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = ("voltmeter-input",)
    perturbs = "voltages"

    def __init__(self, setting: SceneSetting, *, share: float, inner: str = "measure") -> None:
        if inner not in ("measure", "drive"):
            raise ConfigError(f"inner is {inner!r}", remedy="it is 'measure' or 'drive'")
        self._share = number("share", share, most=0.9)
        self._turned = inner == "drive"

    def apply(self, moment: Moment) -> None:
        """Mix the readings in their order."""
        if moment.voltages is None:
            return
        frame = moment.voltages.T if self._turned else moment.voltages
        plain = frame.ravel()
        kept = self._share
        mixed = lfilter([1 - kept], [1, -kept], plain)
        # What the filter, begun at zero, lacks: the memory of its own end, m^(n+1) s[−1].
        before = mixed[-1] / (1 - kept**plain.size)
        mixed = mixed + before * kept ** np.arange(1, plain.size + 1)
        mixed = mixed.reshape(frame.shape)
        moment.voltages = mixed.T if self._turned else mixed
