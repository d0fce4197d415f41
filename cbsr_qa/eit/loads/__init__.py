"""Readings of a sheet under loads, without a mesh for the loads."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .bodies import DeepTank as DeepTank, StripModel as StripModel, check_strip as check_strip
    from .family import LoadFamily as LoadFamily
    from .local import LocalUpdate as LocalUpdate
    from .meshed_sheet import MeshedSheet as MeshedSheet
    from .pinned_disc import PinnedDisc as PinnedDisc
    from .round_load import LoadReadings as LoadReadings, RoundLoadModel as RoundLoadModel, RoundLoads as RoundLoads
    from .sheet import LoadedSheet as LoadedSheet

door(__name__, __file__)
