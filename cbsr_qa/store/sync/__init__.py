"""Store and forward: what a station stored is sent to a central database."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .centre import check_centre as check_centre, refusals as refusals
    from .queue import (
        QUARANTINED as QUARANTINED,
        Backlog as Backlog,
        backlog as backlog,
        held as held,
        let_go as let_go,
        send_again as send_again,
        waiting as waiting,
    )
    from .send import Sent as Sent, send_waiting as send_waiting

door(__name__, __file__)
