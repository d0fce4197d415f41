from .centre import check_centre as check_centre, refusals as refusals
from .queue import (
    QUARANTINED as QUARANTINED,
    Entry as Entry,
    age_h as age_h,
    held as held,
    let_go as let_go,
    send_again as send_again,
    waiting as waiting,
)
from .send import Sent as Sent, send_waiting as send_waiting
