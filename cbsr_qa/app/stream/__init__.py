"""Forces as a live stream: from an instrument that takes frames to programs that need newtons."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .messages import (
        AliveMessage as AliveMessage,
        DroppedMessage as DroppedMessage,
        EndMessage as EndMessage,
        FrameMessage as FrameMessage,
        HeaderMessage as HeaderMessage,
        InterruptedMessage as InterruptedMessage,
        StreamMessage as StreamMessage,
        json_line as json_line,
    )
    from .outlets import Outlets as Outlets
    from .source import FramesFrom as FramesFrom
    from .stream import StreamRequest as StreamRequest, stream_messages as stream_messages

door(__name__, __file__)
