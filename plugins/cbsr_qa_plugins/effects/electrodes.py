"""A lead or a contact in series with an electrode that went bad.

What lies outside the sheet: in series with an electrode, or between two.

Contacts that change in the course of a run.

Contacts that are not alike.

An electrode whose lead opens now and then.

An electrode whose lead is open.

Two electrodes that touch.
"""

import math
from typing import Final

import numpy as np

from cbsr_qa.domain import ConfigError, RefusedError
from cbsr_qa.domain.plan import Moment, SceneSetting, SheetDesign
from cbsr_qa.simulate import RandomStream, electrode, number, parameters, shown

#: Effects on sheet and contacts, which leave what is outside as it is.
BESIDE_THE_SHEET: Final = ("temperature-drift",)


def in_series(moment: Moment, electrode: int, resistance_ohm: float) -> None:
    """Add a resistance to an electrode's own potential.

    A voltmeter draws no current through it: only the driven pairs of this electrode show it.
    """
    if moment.impedance_ohm is not None:
        impedance = moment.impedance_ohm.copy()
        impedance[electrode, electrode] += resistance_ohm
        moment.impedance_ohm = impedance


_MOST: Final = 50.0  # change of ln z; no sheet can be solved with contacts that far off


class ContactDrift:
    """Every contact impedance grows or falls exponentially at a rate of its own, Gaussian, drawn once per seed.

    Parameters
    ----------
    deviation_per_hour : standard deviation of the change of ln z in an hour.
    """

    needs: tuple[str, ...] = ()
    perturbs = "contacts"

    def __init__(self, setting: SceneSetting, *, deviation_per_hour: float) -> None:
        per_s = number("deviation_per_hour", deviation_per_hour, most=10.0) / 3600
        count = setting.sensor_type.electrodes.count
        self._rate_per_s = per_s * RandomStream(setting.seed, "contact-drift").normal(0, (count,))

    def apply(self, moment: Moment) -> None:
        """Change the contacts by what has passed since the run began."""
        if moment.contact_mm is None:
            return
        grown = self._rate_per_s * moment.run_s
        worst = int(np.abs(grown).argmax())
        if abs(grown[worst]) > _MOST:
            raise RefusedError(
                f"contact-drift makes contact {worst} e^{grown[worst]:.0f} of what it was at {moment.run_s:g} s",
                remedy="take a smaller deviation_per_hour",
            )
        moment.contact_mm = moment.contact_mm * np.exp(grown)


class ContactSpread:
    """Contact impedances scatter about a common one: log-normal, independent, drawn once per seed.

    Parameters
    ----------
    deviation : standard deviation over the mean.
    contact_mm : mean impedance over the sheet's resistance; by default the sheet's own.
    """

    needs: tuple[str, ...] = ()
    perturbs = "sheet"

    def __init__(self, setting: SceneSetting, *, deviation: float, contact_mm: float | None = None) -> None:
        self._spread = float(np.sqrt(np.log1p(number("deviation", deviation, most=10.0) ** 2)))
        self._mean_mm = None if contact_mm is None else number("contact_mm", contact_mm, above=True)
        self._stream = RandomStream(setting.seed, "contact-spread")

    def design(self, design: SheetDesign) -> None:
        """Scatter the contacts."""
        factor = np.exp(self._spread * self._stream.normal(0, design.contact_mm.shape) - self._spread**2 / 2)
        mean_mm = design.contact_mm if self._mean_mm is None else self._mean_mm
        design.contact_mm = mean_mm * factor


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


class ElectrodeOpen:
    """The lead of an electrode is open: its driven pairs carry what the source's limit drives through a leak.

    The other pairs are not affected as long as the voltmeter draws no current: the floating lead then has the
    potential of its contact. What a real input makes of it is ``voltmeter-input``.

    Parameters
    ----------
    electrode : its number.
    resistance_ohm : of the open lead; 1 GΩ is chosen by us (surface leakage of a connector).
    from_s, to_s : when, on the run's time line; by default always.
    """

    needs: tuple[str, ...] = ("source-compliance",)
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        electrode: int,
        resistance_ohm: float = 1e9,
        from_s: float = 0.0,
        to_s: float = 1e12,
    ) -> None:
        self._electrode = parameters.electrode("electrode", electrode, setting.sensor_type.electrodes.count)
        self._ohm = number("resistance_ohm", resistance_ohm, above=True, most=1e12)
        self._from_s = number("from_s", from_s)
        self._to_s = number("to_s", to_s, least=self._from_s, above=True)

    def apply(self, moment: Moment) -> None:
        """Open the lead."""
        if self._from_s <= moment.run_s < self._to_s:
            in_series(moment, self._electrode, self._ohm)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """When it begins and ends."""
        began_s = moment.setting.began_s
        return [at_s - began_s for at_s in (self._from_s, self._to_s) if first_s < at_s - began_s <= last_s]


class ElectrodeShort:
    """Two electrodes touch: there is a resistance between them, beside the sheet.

    Exact: with Z the sheet's transfer impedance and a = e_i − e_j, the short takes Z a aᵀ Z/(r + aᵀ Z a) from it.

    Parameters
    ----------
    electrodes : the two.
    resistance_ohm : between them; 0 is a dead short.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"

    def __init__(self, setting: SceneSetting, *, electrodes: list[int], resistance_ohm: float = 0.0) -> None:
        count = setting.sensor_type.electrodes.count
        if not isinstance(electrodes, list | tuple) or len(electrodes) != 2 or electrodes[0] == electrodes[1]:
            raise ConfigError(f"electrodes is {shown(electrodes)}", remedy="it is a list of two different electrodes")
        self._between = np.zeros(count)
        for number_, sign in zip(electrodes, (1.0, -1.0), strict=True):
            self._between[electrode("electrodes", number_, count)] = sign
        self._ohm = number("resistance_ohm", resistance_ohm)

    def apply(self, moment: Moment) -> None:
        """Put the resistance beside the sheet."""
        if moment.impedance_ohm is not None:
            seen = moment.impedance_ohm @ self._between
            moment.impedance_ohm = moment.impedance_ohm - np.outer(seen, seen) / (self._ohm + self._between @ seen)


class LeadResistance:
    """A lead is bad: there is a resistance between an electrode and the multiplexer, from one time to another.

    A voltmeter draws no current: only the driven pairs of this electrode show it, as more resistance. A lead that
    is open is ``electrode-open``.

    Parameters
    ----------
    electrode : its number.
    resistance_ohm : in series.
    from_s, to_s : when, on the run's time line; by default always.
    """

    needs: tuple[str, ...] = ()
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"

    def __init__(
        self,
        setting: SceneSetting,
        *,
        electrode: int,
        resistance_ohm: float,
        from_s: float = 0.0,
        to_s: float = 1e12,
    ) -> None:
        self._electrode = parameters.electrode("electrode", electrode, setting.sensor_type.electrodes.count)
        self._ohm = number("resistance_ohm", resistance_ohm, most=1e12)
        self._from_s = number("from_s", from_s)
        self._to_s = number("to_s", to_s, least=self._from_s, above=True)

    def apply(self, moment: Moment) -> None:
        """Put it in series."""
        if self._from_s <= moment.run_s < self._to_s:
            in_series(moment, self._electrode, self._ohm)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        """When it begins and ends."""
        began_s = moment.setting.began_s
        return [at_s - began_s for at_s in (self._from_s, self._to_s) if first_s < at_s - began_s <= last_s]
