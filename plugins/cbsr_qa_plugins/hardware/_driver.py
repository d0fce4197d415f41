"""What drivers have in common: kinds of options, an identity, and errors that name role and address."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Final, Protocol, TypeVar

import numpy as np
from pydantic import AfterValidator, Field

from cbsr_qa.plugin import (
    CheckOutcome,
    CheckResult,
    ConfigError,
    InstrumentError,
    InstrumentIdentity,
    Motion,
    StationContext,
)

#: Where a station states no motion: the rig's press speed of 40 mm/min, and the shipped station's other numbers.
RIG_MOTION: Final = Motion(press_speed_mm_s=40 / 60, travel_speed_mm_s=10.0, hover_mm=25.0)

Number = TypeVar("Number", bound=float)


def _check_not_empty(text: str) -> str:
    if not text.strip():
        raise ValueError("it must be text that is not empty")
    return text


def _check_nonzero(number: Number) -> Number:
    if number == 0:
        raise ValueError("it must be a number other than 0")
    return number


Text = Annotated[str, AfterValidator(_check_not_empty)]
Port = Annotated[Text, Field(description='the path of a serial port, or "usb:VID:PID:SERIAL"')]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]
Factor = Annotated[float, AfterValidator(_check_nonzero)]
Sign = Annotated[int, Field(ge=-1, le=1), AfterValidator(_check_nonzero)]


class Closable(Protocol):
    """What is given back."""

    def close(self) -> None: ...


@contextmanager
def close_on_error(opened: Closable) -> Iterator[None]:
    """Give back what was opened if the rest of an opening fails: the next attempt must find it free."""
    try:
        yield
    except BaseException:
        opened.close()
        raise


def config_error(context: StationContext, driver: str, problem: str, remedy: str) -> ConfigError:
    """Return the error of a station file, sensor type or station that this driver cannot work with."""
    return ConfigError(f"instrument {context.role!r} ({driver}){problem}", remedy=remedy)


def check_result(
    name: str,
    well: bool,
    value: float | None = None,
    unit: str = "",
    allowed: str = "",
    *,
    remedy: str = "",
    said: str = "",
    otherwise: CheckOutcome = CheckOutcome.FAILED,
) -> CheckResult:
    """Return a line of a self-test; it names the remedy only where all is not well."""
    outcome = CheckOutcome.OK if well else otherwise
    return CheckResult(name, outcome, value, unit, allowed, "" if well else remedy, said)


class DriverBase:
    """An instrument of a bench; it has nothing to make safe and nothing to give back unless a driver says so.

    Parameters
    ----------
    driver : registered name.
    address : for messages.
    """

    def __init__(self, context: StationContext, driver: str, address: str) -> None:
        self._context, self._driver, self._address = context, driver, address
        self._role, self._clock = context.role, context.clock

    def safe_state(self) -> None:
        """Do nothing: it neither moves nor drives."""

    def close(self) -> None:
        """Give back nothing."""

    def _build_identity(
        self,
        model: str,
        serial: str = "",
        firmware: str = "",
        *,
        simulated: bool = False,
        notes: tuple[tuple[str, str], ...] = (),
    ) -> InstrumentIdentity:
        return InstrumentIdentity(self._role, self._driver, model, serial, firmware, simulated=simulated, notes=notes)

    def _check_count(self, count: int, *, retryable: bool = False) -> None:
        """Refuse a count below 1."""
        if count < 1:
            raise self._error(f"{count} frames were asked for; at least 1 is needed", retryable=retryable)

    def _error(self, reason: str, remedy: str = "", *, retryable: bool = False) -> InstrumentError:
        return InstrumentError(self._role, self._address, reason, remedy=remedy, retryable=retryable)

    def _restate_error(self, error: InstrumentError, *, retryable: bool) -> InstrumentError:
        """Return an error of this instrument, retryable or not."""
        reason = error.reason.removeprefix(f"{error.role} at {error.address}: ")
        return self._error(reason, error.remedy, retryable=retryable)


class HeadDriver(DriverBase):
    """A head over a sheet, with checked targets."""

    def _check_place(self, x_mm: float, y_mm: float) -> None:
        outline = self._context.sensor_type.outline
        if not outline.clearance_mm(np.array([[x_mm, y_mm]]))[0] >= 0:
            raise self._error(f"({x_mm:g}, {y_mm:g}) mm is outside the sheet", f"the sheet {outline.words()}")

    def _check_press(self, depth_mm: float, speed_mm_s: float) -> None:
        thickness_mm = self._context.sensor_type.thickness_mm
        if not (0 <= depth_mm < thickness_mm and speed_mm_s > 0):
            raise self._error(
                f"cannot press {depth_mm:g} mm deep at {speed_mm_s:g} mm/s",
                f"the depth is from 0 to below the sheet's {thickness_mm:g} mm, the speed above 0",
            )
