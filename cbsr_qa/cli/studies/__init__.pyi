from . import (
    charts as charts,
    compare as compare,
    frontier as frontier,
    gauge as gauge,
    limits as limits,
    reproduce as reproduce,
    scene as scene,
    stability as stability,
)
