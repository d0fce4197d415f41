"""An electrode whose lead opens now and then."""

import math
from typing import Final

from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.simulate import parameters
from cbsr_qa.simulate.parameters import number
from cbsr_qa.simulate.streams import RandomStream
from cbsr_qa_plugins.effects._leads import BESIDE_THE_SHEET, in_series

_A_BLOCK: Final = 16.0  # events on average; one of e^16 blocks is empty


class ElectrodeIntermittent:
    """The lead of an electrode opens and closes at random, for times that are exponentially distributed.

    The two-state Markov process by uniformisation: events come as a Poisson process of the rate 1/open + 1/closed,
    and at each the lead is found open with the probability open/(open + closed), whatever it was before. So the
    state at a time is the mark of the last event, events of separate blocks of time are independent, and each block
    has random numbers of its own: any time of a run can be asked for in any order, and a resumed session goes on
    with the same history.

    Parameters
    ----------
    electrode : its number.
    mean_open_s, mean_closed_s : mean times, each time it opens and closes.
    resistance_ohm : of the open lead, as of ``electrode-open``.
    """

    needs: tuple[str, ...] = ("source-compliance",)
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        electrode: int,
        mean_open_s: float,
        mean_closed_s: float,
        resistance_ohm: float = 1e9,
    ) -> None:
        self._electrode = parameters.electrode("electrode", electrode, setting.sensor_type.electrodes.count)
        open_s = number("mean_open_s", mean_open_s, least=1e-2, most=1e9)
        closed_s = number("mean_closed_s", mean_closed_s, least=1e-2, most=1e9)
        self._ohm = number("resistance_ohm", resistance_ohm, above=True, most=1e12)
        self._share_open = open_s / (open_s + closed_s)
        self._block_s = _A_BLOCK * open_s * closed_s / (open_s + closed_s)
        self._stream = RandomStream(setting.seed, "electrode-intermittent")

    def apply(self, moment: Moment) -> None:
        """Open the lead if this is a time at which it is."""
        if self._is_open(moment.run_s):
            in_series(moment, self._electrode, self._ohm)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """When it opens or closes."""
        began_s = moment.setting.began_s
        first_s, last_s = first_s + began_s, last_s + began_s
        blocks = range(math.floor(max(first_s, 0.0) / self._block_s), math.floor(last_s / self._block_s) + 1)
        was, found = self._is_open(first_s), []
        for at_s, mark in (event for block in blocks for event in self._events(block)):
            if first_s < at_s <= last_s and mark != was:
                was = mark
                found.append(at_s - began_s)
        return found

    def _is_open(self, time_s: float) -> bool:
        block = math.floor(time_s / self._block_s)
        while block >= 0:
            events = [mark for at_s, mark in self._events(block) if at_s <= time_s]
            if events:
                return events[-1]
            block -= 1
        # Before the first event: as the run found it.
        return bool(self._stream.generator(0).uniform() < self._share_open)

    def _events(self, block: int) -> list[tuple[float, bool]]:
        """Times of a block's events, rising, and whether the lead is open after each."""
        random = self._stream.generator(1 + block)
        count = int(random.poisson(_A_BLOCK))
        times = (block + random.uniform(size=count)) * self._block_s
        times.sort()
        marks = random.uniform(size=count) < self._share_open
        return list(zip(times.tolist(), marks.tolist(), strict=True))
