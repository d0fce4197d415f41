from .bench import BenchFindings as BenchFindings
from .check import CheckRequest as CheckRequest, check_station as check_station
from .outcome import CheckedStation as CheckedStation
