"""Operating system services: clocks, atomic files, locks, limited child processes."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .beside import Ahead as Ahead, side_by_side as side_by_side
    from .clock import (
        TICK_S as TICK_S,
        Clock as Clock,
        RealClock as RealClock,
        Stages as Stages,
        VirtualClock as VirtualClock,
        WallWatch as WallWatch,
        in_ticks as in_ticks,
        on_tick as on_tick,
        passing as passing,
    )
    from .copies import (
        COPY_ENDED as COPY_ENDED,
        come_back_once as come_back_once,
        end_copies_of_threads as end_copies_of_threads,
        end_copy as end_copy,
    )
    from .files import (
        FileLock as FileLock,
        HeldError as HeldError,
        csv_text as csv_text,
        holder as holder,
        writing as writing,
        written_whole as written_whole,
    )
    from .foreign import (
        LARGEST_FILE as LARGEST_FILE,
        UnfitFileError as UnfitFileError,
        check_regular as check_regular,
        open_foreign as open_foreign,
        read_foreign as read_foreign,
    )
    from .json_text import parsed_json as parsed_json
    from .pins import (
        hashed_pin as hashed_pin,
        pin_allowed as pin_allowed,
        pin_hash_readable as pin_hash_readable,
        pin_matches as pin_matches,
    )
    from .redelivery import Redelivery as Redelivery
    from .reserve import MemoryReserve as MemoryReserve
    from .secret import secret_of as secret_of
    from .stubborn import be_watched as be_watched, end_later as end_later
    from .untrusted import (
        CONTAINED as CONTAINED,
        largest_content as largest_content,
        read_untrusted as read_untrusted,
    )
    from .workers import heard_later as heard_later, worker_pool as worker_pool

door(__name__, __file__)
