"""A station checked: instruments, reference ring, golden sensor."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .bench import BenchFindings as BenchFindings
    from .check import CheckRequest as CheckRequest, check_station as check_station
    from .outcome import CheckedStation as CheckedStation

door(__name__, __file__)
