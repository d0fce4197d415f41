"""Station files for tests that mount instruments of their own."""

_STATION = """
[station]
name = "{name}"
clock = "{clock}"
sensor_type = "disc-100mm"
material = "cbsr-8wt"

[indenter]
diameter_mm = 13.0

[motion]
press_speed_mm_per_min = 40.0
travel_speed_mm_per_min = 600.0
hover_mm = 25.0

[safety]
"""
_SAFETY = {"force_N": 20.0, "strain_percent": 35.0, "travel_radius_mm": 41.0, "duration_h": 12.0, "stale_s": 2.0}


def station_file(name: str, instruments: str, *, clock: str = "virtual", **safety: float) -> str:
    """Text of a station of the shipped sensor type with the given tables of instruments.

    Keywords are limits of its safety, by key of the file; those not given are alike in every station.
    """
    limits = "".join(f"{key} = {value}\n" for key, value in {**_SAFETY, **safety}.items())
    return _STATION.format(name=name, clock=clock) + limits + instruments
