from .clock import Fault as Fault, WatchedClock as WatchedClock
from .rig import EmulatedRig as EmulatedRig, Emulation as Emulation
from .streams import PtyPort as PtyPort, TcpPort as TcpPort
