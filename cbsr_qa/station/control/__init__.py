"""Control of a run by others than its own terminal: one lock per station, and a channel to the run that holds it."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .client import RunChannel as RunChannel
    from .desk import (
        ControlDesk as ControlDesk,
        Question as Question,
    )
    from .lock import (
        control_socket as control_socket,
        refuse_busy as refuse_busy,
        station_held as station_held,
        station_holder as station_holder,
    )
    from .messages import Activity as Activity, ChannelLine as ChannelLine, SensorUnderTest as SensorUnderTest
    from .server import (
        LONGEST_LINE as LONGEST_LINE,
        RunServer as RunServer,
    )
    from .status import RunStatus as RunStatus

door(__name__, __file__)
