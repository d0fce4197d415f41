from cbsr_qa.lazy import door as door

from .interface import (
    Analysis as Analysis,
    Calibration as Calibration,
    CbsrError as CbsrError,
    Database as Database,
    Flag as Flag,
    ForceStream as ForceStream,
    Images as Images,
    PressCalibration as PressCalibration,
    PressureMap as PressureMap,
    Result as Result,
    Run as Run,
    Scene as Scene,
    analyse as analyse,
    compare as compare,
    image as image,
    load_calibration as load_calibration,
    load_press_calibration as load_press_calibration,
    open_database as open_database,
    run as run,
    simulate_scene as simulate_scene,
    stream as stream,
)

__version__: str
