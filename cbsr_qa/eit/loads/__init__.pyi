from .family import LoadFamily as LoadFamily
from .meshed_sheet import MeshedSheet as MeshedSheet
from .nested import NestedCover as NestedCover, nested_cover as nested_cover
from .patches import Patches as Patches, check_change as check_change, dense_work as dense_work
from .pinned_disc import PinnedDisc as PinnedDisc
from .round_load import LoadReadings as LoadReadings, RoundLoadModel as RoundLoadModel, RoundLoads as RoundLoads
from .sheet import LoadedSheet as LoadedSheet
