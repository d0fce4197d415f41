from .centre import (
    check_centre as check_centre,
    refusals as refusals,
)
from .queue import (
    Entry as Entry,
    age_h as age_h,
    decide as decide,
    held as held,
    waiting as waiting,
)
from .send import Sent as Sent, send_waiting as send_waiting
