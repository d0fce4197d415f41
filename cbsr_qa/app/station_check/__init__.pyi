from .bench import BenchFindings as BenchFindings
from .check import CheckedStation as CheckedStation, CheckRequest as CheckRequest, check_station as check_station
