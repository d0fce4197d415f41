from . import (
    calibration as calibration,
    forward as forward,
    geometry as geometry,
    imaging as imaging,
    loads as loads,
    readings as readings,
    reconstruction as reconstruction,
    relaxation as relaxation,
    smoothness as smoothness,
    statistics as statistics,
    time as time,
)
