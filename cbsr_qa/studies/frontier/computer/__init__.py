"""Sweeps of the computer's clock."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .sweeps import computer_work as computer_work, worth_their_time as worth_their_time

door(__name__, __file__)
