from .client import RunChannel as RunChannel
from .desk import (
    Answer as Answer,
    Brakes as Brakes,
    ControlDesk as ControlDesk,
    Question as Question,
)
from .lock import (
    Holder as Holder,
    control_socket as control_socket,
    refuse_busy as refuse_busy,
    station_held as station_held,
    station_holder as station_holder,
)
from .server import (
    LONGEST_LINE as LONGEST_LINE,
    PROTOCOL as PROTOCOL,
    RunServer as RunServer,
)
from .status import RunStatus as RunStatus
