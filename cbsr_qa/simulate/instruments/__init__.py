"""Emulated instruments on byte streams, all connected to one simulated world."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .rig import EmulatedRig as EmulatedRig, Emulation as Emulation
    from .streams import Fault as Fault, PtyPort as PtyPort, TcpPort as TcpPort, WatchedClock as WatchedClock

door(__name__, __file__)
