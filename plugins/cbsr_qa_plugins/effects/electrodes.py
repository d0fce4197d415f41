"""Effects of electrodes: uneven and drifting contacts, and leads that are bad, open, intermittent or shorted."""

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from cbsr_qa.plugin import Array, Moment, PluginOptions, Problem, RefusedError, SceneSetting, SheetDesign
from cbsr_qa.simulate.effect import Amount, Electrode, Positive, SceneEffect, check_electrode
from cbsr_qa.simulate.streams import RandomStream

#: Effects on the sheet and its contacts, which must be applied before those on leads outside it.
BESIDE_THE_SHEET: Final = ("temperature-drift",)


def add_series_resistance(moment: Moment, electrode: int, resistance_ohm: float) -> None:
    """Add a resistance in series with an electrode: on the diagonal of the transfer impedance, if there is one.

    A voltmeter draws no current through it: only the driven pairs of this electrode show it.
    """
    if moment.impedance_ohm is not None:
        impedance = moment.impedance_ohm.copy()
        impedance[electrode, electrode] += resistance_ohm
        moment.impedance_ohm = impedance


#: Largest change of ln z with which the sheet can still be solved.
_MAX_LOG_CHANGE: Final = 50.0


class ContactDrift(SceneEffect):
    """Every contact impedance drifts exponentially at its own Gaussian rate, drawn once per seed.

    Parameters
    ----------
    deviation_per_hour : standard deviation of the change of ln z per hour.
    """

    class Options(PluginOptions):
        deviation_per_hour: Annotated[float, Field(ge=0, le=10)]

    perturbs = "contacts"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        deviation_per_s = self.options.deviation_per_hour / 3600
        count = setting.sensor_type.electrodes.count
        self._rate_per_s = deviation_per_s * RandomStream(setting.seed, "contact-drift").normal(0, (count,))

    def apply(self, moment: Moment) -> None:
        if moment.contact_mm is None:
            return
        log_change = self._rate_per_s * moment.run_s
        worst = int(np.abs(log_change).argmax())
        if abs(log_change[worst]) > _MAX_LOG_CHANGE:
            raise RefusedError(
                f"contact-drift makes contact {worst} e^{log_change[worst]:.0f} of what it was at {moment.run_s:g} s",
                remedy="take a smaller deviation_per_hour",
            )
        moment.contact_mm = moment.contact_mm * np.exp(log_change)


class ContactSpread(SceneEffect):
    """Contact impedances scatter about a common mean: log-normal, independent, drawn once per seed.

    Parameters
    ----------
    deviation : standard deviation over the mean.
    contact_mm : mean contact impedance over sheet resistance; by default that of the bench.
    """

    class Options(PluginOptions):
        deviation: Annotated[float, Field(ge=0, le=10)]
        contact_mm: Positive | None = None

    perturbs = "sheet"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._spread = float(np.sqrt(np.log1p(self.options.deviation**2)))
        self._stream = RandomStream(setting.seed, "contact-spread")

    def design(self, design: SheetDesign) -> None:
        factor = np.exp(self._spread * self._stream.normal(0, design.contact_mm.shape) - self._spread**2 / 2)
        given_mm = self.options.contact_mm
        mean_mm = design.contact_mm if given_mm is None else given_mm
        design.contact_mm = mean_mm * factor


MeanTime = Annotated[float, Field(ge=1e-2, le=1e9)]
OpenLead = Annotated[float, Field(gt=0, le=1e12)]

#: Mean number of events in a block of time; one of e^16 blocks has none.
_EVENTS_PER_BLOCK: Final = 16.0


class ElectrodeIntermittent(SceneEffect):
    """The lead of an electrode opens and closes at random, for exponentially distributed times.

    The two-state Markov process is made by uniformisation: events are a Poisson process of the rate 1/open +
    1/closed, and after each event the lead is open with the probability open/(open + closed), whatever its state
    before. Blocks of time have separate random numbers, so any time of a run can be requested in any order, and a
    resumed session continues the same history.

    Parameters
    ----------
    electrode : number of the electrode.
    mean_open_s, mean_closed_s : mean duration of an open and of a closed period.
    resistance_ohm : resistance of the open lead, as in ``electrode-open``.
    """

    class Options(PluginOptions):
        electrode: Electrode
        mean_open_s: MeanTime
        mean_closed_s: MeanTime
        resistance_ohm: OpenLead = 1e9

    needs: tuple[str, ...] = ("source-compliance",)
    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        check_electrode("electrode", self.options.electrode, setting)
        open_s, closed_s = self.options.mean_open_s, self.options.mean_closed_s
        self._share_open = open_s / (open_s + closed_s)
        self._block_s = _EVENTS_PER_BLOCK * open_s * closed_s / (open_s + closed_s)
        self._stream = RandomStream(setting.seed, "electrode-intermittent")

    def apply(self, moment: Moment) -> None:
        if self._is_open(moment.run_s):
            add_series_resistance(moment, self.options.electrode, self.options.resistance_ohm)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        began_s = moment.setting.began_s
        first_s, last_s = first_s + began_s, last_s + began_s
        blocks = range(math.floor(max(first_s, 0.0) / self._block_s), math.floor(last_s / self._block_s) + 1)
        was_open, switch_times_s = self._is_open(first_s), []
        for at_s, is_open in (event for block in blocks for event in self._events(block)):
            if first_s < at_s <= last_s and is_open != was_open:
                was_open = is_open
                switch_times_s.append(at_s - began_s)
        return switch_times_s

    def _is_open(self, time_s: float) -> bool:
        block = math.floor(time_s / self._block_s)
        while block >= 0:
            states = [is_open for at_s, is_open in self._events(block) if at_s <= time_s]
            if states:
                return states[-1]
            block -= 1
        # Before the first event the state is drawn from a stream of its own.
        return bool(self._stream.generator(0).uniform() < self._share_open)

    def _events(self, block: int) -> list[tuple[float, bool]]:
        """Return the times of a block's events [s], rising, and whether the lead is open after each."""
        random = self._stream.generator(1 + block)
        count = int(random.poisson(_EVENTS_PER_BLOCK))
        times_s = (block + random.uniform(size=count)) * self._block_s
        times_s.sort()
        is_open = random.uniform(size=count) < self._share_open
        return list(zip(times_s.tolist(), is_open.tolist(), strict=True))


class _LeadOptions(PluginOptions):
    electrode: Electrode
    resistance_ohm: Amount
    from_s: Amount = 0.0
    to_s: Amount = 1e12

    def problems(self) -> Iterator[Problem]:
        if self.to_s <= self.from_s:
            yield Problem(("to_s",), f"is {self.to_s:g}", f"it must be a number above from_s, {self.from_s:g}")


class _BadLead(SceneEffect):
    """A resistance between an electrode and the multiplexer, from one time to another."""

    Options: ClassVar[type[PluginOptions]] = _LeadOptions
    after = BESIDE_THE_SHEET
    perturbs = "impedance"
    options: _LeadOptions

    def prepare(self, setting: SceneSetting) -> None:
        check_electrode("electrode", self.options.electrode, setting)

    def apply(self, moment: Moment) -> None:
        if self.options.from_s <= moment.run_s < self.options.to_s:
            add_series_resistance(moment, self.options.electrode, self.options.resistance_ohm)

    def switches(self, moment: Moment, first_s: float, last_s: float) -> list[float]:
        times_s = (at_s - moment.setting.began_s for at_s in (self.options.from_s, self.options.to_s))
        return [at_s for at_s in times_s if first_s < at_s <= last_s]


class ElectrodeOpen(_BadLead):
    """The lead of an electrode is open: its driven pairs carry only what the source drives through a leak.

    The other pairs are not affected as long as the voltmeter draws no current: the floating lead then has the
    potential of its contact. For a real voltmeter see ``voltmeter-input``.

    Parameters
    ----------
    electrode : number of the electrode.
    resistance_ohm : resistance of the open lead; 1 GΩ is chosen by us (surface leakage of a connector).
    from_s, to_s : start and end, in time of the run; by default always.
    """

    class Options(_LeadOptions):
        resistance_ohm: OpenLead = 1e9

    needs: tuple[str, ...] = ("source-compliance",)
    options: Options


class ElectrodeShort(SceneEffect):
    """Two electrodes are shorted by a resistance in parallel with the sheet.

    Exact: with the sheet's transfer impedance Z and a = e_i − e_j, the short subtracts Z a aᵀ Z/(r + aᵀ Z a) from Z.

    Parameters
    ----------
    electrodes : numbers of the two electrodes.
    resistance_ohm : resistance between them; 0 is a dead short.
    """

    class Options(PluginOptions):
        electrodes: Annotated[tuple[Electrode, Electrode], Array]
        resistance_ohm: Amount = 0.0

        def problems(self) -> Iterator[Problem]:
            if self.electrodes[0] == self.electrodes[1]:
                yield Problem(("electrodes",), f"is {list(self.electrodes)}", "it must be two different electrodes")

    after: tuple[str, ...] = BESIDE_THE_SHEET
    perturbs = "impedance"
    options: Options

    def prepare(self, setting: SceneSetting) -> None:
        self._between = np.zeros(setting.sensor_type.electrodes.count)
        for electrode, sign in zip(self.options.electrodes, (1.0, -1.0), strict=True):
            check_electrode("electrodes", electrode, setting)
            self._between[electrode] = sign

    def apply(self, moment: Moment) -> None:
        if moment.impedance_ohm is not None:
            # Potentials of all electrodes for unit current from one shorted electrode to the other: Z a.
            potentials_ohm = moment.impedance_ohm @ self._between
            loop_ohm = self.options.resistance_ohm + self._between @ potentials_ohm
            moment.impedance_ohm = moment.impedance_ohm - np.outer(potentials_ohm, potentials_ohm) / loop_ohm


class LeadResistance(_BadLead):
    """A resistance is in series with the lead of an electrode.

    A voltmeter draws no current, so only the driven pairs of this electrode show it, as more resistance. For an open
    lead see ``electrode-open``.

    Parameters
    ----------
    electrode : number of the electrode.
    resistance_ohm : resistance in series.
    from_s, to_s : start and end, in time of the run; by default always.
    """

    class Options(_LeadOptions):
        resistance_ohm: Annotated[float, Field(ge=0, le=1e12)]

    options: Options
