"""What a head that moves by itself holds the force against."""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from cbsr_qa.plugin import ConfigError, Instrument, InstrumentError, SafetyError, SafetyLimits, Sampler
from cbsr_qa.system.clock import Clock

#: Makes an error of a reason and a remedy.
Fail = Callable[[str, str], InstrumentError]

CHANNEL: Final = "force"
#: Where no station says what it allows: the shipped station's.
_CEILING_N: Final = 20.0
_STALE_S: Final = 2.0


def force_among(peers: Mapping[str, Instrument]) -> Sampler:
    """Return the instrument of a bench that samples the force. ConfigError if missing."""
    for instrument in peers.values():
        if isinstance(instrument, Sampler) and instrument.channel == CHANNEL:
            return instrument
    raise ConfigError(
        f"it presses, and needs an instrument that samples {CHANNEL!r}",
        remedy=f"provide {CHANNEL!r} by one of the station's instruments",
    )


class ForceWatch:
    """Looks at the force while the head moves: ceiling and freshness, by the station's limits.

    ``safety``: None where no station says anything.
    """

    def __init__(self, force: Sampler, clock: Clock, safety: SafetyLimits | None, fail: Fail) -> None:
        self._force = force
        self._clock = clock
        self._ceiling_N = safety.force_N if safety else _CEILING_N
        self.stale_s = safety.stale_s if safety else _STALE_S
        self._fail = fail
        self._newest_s = -np.inf

    def look(self) -> None:
        """Hold what was sampled since the last look against the limits.

        SafetyError with the interlock's rules: ``force`` above the ceiling, or ``stale force``.
        """
        now_s = self._clock.now()
        block = self._force.samples_since(max(self._newest_s, now_s - self.stale_s))
        if len(block):
            self._newest_s = float(block.time_s[-1])
            self._hold(float(np.abs(block.values).max()))
        age_s = now_s - self._newest_s
        if age_s > self.stale_s:
            age = f"is {age_s:.3g} s old" if np.isfinite(age_s) else f"did not come for {self.stale_s:g} s"
            raise SafetyError(
                "stale force",
                f"the last force sample {age}; the station allows {self.stale_s:g} s while the head moves",
                remedy="check the load cell and its cable",
            )

    def mean_since(self, time_s: float) -> float:
        """Return the mean force since a time; waits for a sample, but no longer than one may be old [N].

        InstrumentError without samples; SafetyError if one is above the limit.
        """
        late_s = self._clock.now() + self.stale_s
        while not len(block := self._force.samples_since(time_s)):
            if self._clock.now() >= late_s:
                reason = f"no force sample was taken within {self.stale_s:g} s of the last step down"
                raise self._fail(reason, "check the load cell and its cable")
            self._clock.sleep(self.stale_s / 8)
        self._newest_s = max(self._newest_s, float(block.time_s[-1]))
        self._hold(float(np.abs(block.values).max()))
        return float(block.values.mean())

    def _hold(self, peak_N: float) -> None:
        if not peak_N <= self._ceiling_N:
            reason = f"{peak_N:.3g} N measured; the station allows {self._ceiling_N:g} N"
            raise SafetyError("force", reason if np.isfinite(peak_N) else "the force is not a number")
