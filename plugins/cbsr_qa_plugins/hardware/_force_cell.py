"""What load cells have in common, whatever they are read by: zero, limit, and a known mass."""

from collections.abc import Callable
from typing import Annotated, Final, Protocol

import numpy as np
from pydantic import Field

from cbsr_qa.domain.numbers import Array
from cbsr_qa.plugin import (
    CheckOutcome,
    CheckResult,
    InstrumentIdentity,
    PluginOptions,
    SafetyError,
    SampleBlock,
    StationContext,
)
from cbsr_qa_plugins.hardware._driver import DriverBase, Factor, Sign, check_result

#: Newtons of one gram force: standard gravity (CGPM 1901); places on earth differ by half a percent at most.
NEWTON_PER_G: Final = 9.80665e-3


#: Beyond this share of its limit a cell is at its limit: amplifiers end a digit or two before it.
_AT_LIMIT: Final = 0.999
#: So many samples there after each other are flat.
_FLAT: Final = 2
#: How far the weight of a known mass may be from what is read.
_WEIGHT_SHARE: Final = 0.01
_TEST_S: Final = 2.0
_UNITS: Final = {"N": 1.0, "counts": 1.0, "g": NEWTON_PER_G}


class ForceSource(Protocol):
    """What a cell is read by; forces in newtons before any tare."""

    def samples_since(self, time_s: float) -> tuple[Array, Array]:
        """Return times [s] and forces [N], both (n,), after a time."""

    def newest(self, count: int) -> Array:
        """Return the last forces [N], at most so many, (n,)."""

    def check_alive(self) -> None:
        """Raise InstrumentError if it has fallen silent."""

    def close(self) -> None: ...


class CellOptions(PluginOptions):
    """Options of every load cell's table beside those of its link."""

    scale: Factor = 1.0
    offset: float = 0.0
    sign: Sign = 1
    limit_N: Annotated[float, Field(ge=1e-3)] | None = None
    tare_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    tare_limit_N: Annotated[float, Field(ge=0)] = 0.5
    dead_weight_g: Annotated[float, Field(ge=0.1)] | None = None

    def force_N(self, number: float, unit: str) -> float:
        """Return the force of a number, compression positive [N]: sign × (scale × number + offset) in ``unit``.

        Parameters
        ----------
        unit : ``"N"``, ``"g"`` or ``"counts"``.
        """
        return self.sign * _UNITS[unit] * (self.scale * number + self.offset)


class ForceCell(DriverBase):
    """Samples ``force`` all the time, compression positive.

    ``who``: model, serial number and firmware, queried only while it answers.
    """

    channel = "force"
    unit = "N"

    def __init__(
        self,
        context: StationContext,
        source: ForceSource,
        settings: CellOptions,
        *,
        driver: str,
        address: str,
        who: Callable[[], tuple[str, ...]],
    ) -> None:
        super().__init__(context, driver, address)
        self._source, self._settings, self._who = source, settings, who
        self._zero_N = 0.0

    def identity(self) -> InstrumentIdentity:
        """Say who it is, while it sends, and what was taken for zero at the opening."""
        self._source.check_alive()
        notes: tuple[tuple[str, str], ...] = ()
        if self._settings.tare_s > 0:
            notes = (("tare", f"{self._zero_N:.4g} N, mean of {self._settings.tare_s:g} s".replace("-", "−")),)
        return self._build_identity(*self._who(), notes=notes)

    def alive(self) -> None:
        """Raise InstrumentError if it has fallen silent."""
        self._source.check_alive()

    def close(self) -> None:
        self._source.close()

    def samples_since(self, time_s: float) -> SampleBlock:
        """Return the force after a time on the station's clock, up to now.

        InstrumentError if the link is down, or carries something else; SafetyError with rule ``force``, while the
        cell is at its limit: the force may be anything above it.
        """
        times, values = self._source.samples_since(time_s)
        self._check_limit()
        return SampleBlock(self.channel, self.unit, times, values - self._zero_N)

    def tare(self) -> float:
        """Take the mean of the coming seconds as zero, as its table says; returns by how much it was shifted [N].

        InstrumentError if something presses on the cell.
        """
        settings = self._settings
        if settings.tare_s == 0:
            return 0.0
        mean_N, _ = self._mean_N(settings.tare_s)
        shift_N = mean_N - self._zero_N
        if abs(shift_N) > settings.tare_limit_N:
            raise self._error(
                f"it reads {shift_N:.3g} N before it is tared; more than {settings.tare_limit_N:g} N is not a zero",
                "take off what presses on it, lift the head, or correct 'offset' in its table",
            )
        self._zero_N = mean_N
        return shift_N

    def self_test(self) -> tuple[CheckResult, ...]:
        """Look at zero and noise for two seconds, and hold a known mass against what is read if there is one.

        Returns lines ``zero``, ``noise`` and ``dead weight``; for the last the operator puts the mass on.
        """
        mean_N, error_N = self._mean_N(_TEST_S)
        zero_N, limit_N = mean_N - self._zero_N, self._settings.tare_limit_N
        zero = check_result(
            "zero",
            abs(zero_N) <= limit_N,
            zero_N,
            "N",
            f"within {limit_N:g} N",
            remedy="take off what presses on it, or tare it",
            otherwise=CheckOutcome.WARNING,
        )
        noise = CheckResult("noise", CheckOutcome.OK, error_N, "N", said=f"standard error over {_TEST_S:g} s")
        return zero, noise, self._dead_weight()

    def _dead_weight(self) -> CheckResult:
        mass_g, ask = self._settings.dead_weight_g, self._context.ask
        if mass_g is None:
            return _skip_dead_weight("state a mass as 'dead_weight_g' in its table")
        if ask is None:
            return _skip_dead_weight("somebody must put the mass on: start the check on a terminal")
        ask(f"Put {mass_g:g} g on the load cell {self._role!r}.")
        mean_N, error_N = self._mean_N(_TEST_S)
        ask(f"Take the {mass_g:g} g off again.")
        found_N, expected_N = mean_N - self._zero_N, NEWTON_PER_G * mass_g
        tolerance_N = _WEIGHT_SHARE * expected_N
        expected = f"{expected_N:.4g} N ± {tolerance_N:.2g} N"
        return check_result(
            "dead weight",
            abs(found_N - expected_N) <= tolerance_N,
            found_N,
            "N",
            expected,
            remedy="correct 'scale' and 'offset' in its table, or have it calibrated",
            said=f"{found_N:.4g} N ± {error_N:.1g} N under {mass_g:g} g; {expected} expected",
        )

    def _mean_N(self, window_s: float) -> tuple[float, float]:
        """Return the mean over the coming seconds, before the tare, and its standard error [N]."""
        since_s = self._clock.now()
        self._clock.sleep(window_s)
        _, values = self._source.samples_since(since_s)
        if not len(values):
            raise self._error(f"it sent nothing for {window_s:g} s", "check its power and its cable")
        self._check_limit()
        spread_N = float(values.std(ddof=1)) if len(values) > 1 else 0.0
        return float(values.mean()), spread_N / float(np.sqrt(len(values)))

    def _check_limit(self) -> None:
        """Refuse a cell whose readings are constant at its limit."""
        limit_N = self._settings.limit_N
        if limit_N is None:
            return
        last = np.abs(self._source.newest(_FLAT))
        if len(last) == _FLAT and (last >= _AT_LIMIT * limit_N).all():
            raise SafetyError(
                "force",
                f"{self._role} stands at its limit of {limit_N:g} N: the force may be anything above",
                remedy="check what presses on it; a cell that stays there unloaded is broken",
            )


def _skip_dead_weight(remedy: str) -> CheckResult:
    return CheckResult("dead weight", CheckOutcome.NOT_DONE, remedy=remedy)
