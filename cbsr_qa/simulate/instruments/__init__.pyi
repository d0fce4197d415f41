from .rig import EmulatedRig as EmulatedRig, Emulation as Emulation
from .streams import Fault as Fault, PtyPort as PtyPort, TcpPort as TcpPort, WatchedClock as WatchedClock
