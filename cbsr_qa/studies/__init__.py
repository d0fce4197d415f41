"""Studies of many runs, or of many simulations."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .fleet_demo import (
        ONE_STATION as ONE_STATION,
        REPEATED as REPEATED,
        SAID as SAID,
        THIRD_ON_ALL as THIRD_ON_ALL,
        build_fleet as build_fleet,
    )
    from .selection import check_names as check_names, measuring_digest as measuring_digest
    from .simulated import configuration_of as configuration_of, shipped as shipped, simulated_run as simulated_run

door(__name__, __file__)
