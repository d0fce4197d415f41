"""Kinds of options that drivers have in common."""

from typing import Annotated, Final, TypeVar

from pydantic import AfterValidator, Field

from cbsr_qa.domain.plan import Motion

#: Where a station states no motion: the rig's press speed of 40 mm/min, and the shipped station's other numbers.
RIG_MOTION: Final = Motion(press_speed_mm_s=40 / 60, travel_speed_mm_s=10.0, hover_mm=25.0)

Number = TypeVar("Number", bound=float)


def _said(text: str) -> str:
    if not text.strip():
        raise ValueError("it must be text that is not empty")
    return text


def _not_zero(number: Number) -> Number:
    if number == 0:
        raise ValueError("it must be a number other than 0")
    return number


Text = Annotated[str, AfterValidator(_said)]
Port = Annotated[Text, Field(description='the path of a serial port, or "usb:VID:PID:SERIAL"')]
Baud = Annotated[int, Field(ge=300, le=4_000_000)]
Factor = Annotated[float, AfterValidator(_not_zero)]
Sign = Annotated[int, Field(ge=-1, le=1), AfterValidator(_not_zero)]
