"""The checks before every run, and what they rest on: releases of files."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .gate import (
        ASKED_AGAIN as ASKED_AGAIN,
        ask_before as ask_before,
        ask_gate as ask_gate,
        asked_again as asked_again,
        gate_refusal as gate_refusal,
    )
    from .people import asks_pin as asks_pin, is_pin_of as is_pin_of
    from .release_list import ReleaseList as ReleaseList, list_releases as list_releases
    from .releases import Released as Released, ReleaseRequest as ReleaseRequest, release_file as release_file
    from .request import GateRequest as GateRequest, Override as Override
    from .shown import GateShown as GateShown, gate_outcome as gate_outcome
    from .station_state import past_due as past_due

door(__name__, __file__)
