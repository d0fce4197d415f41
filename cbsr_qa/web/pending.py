"""Stand-ins until the channel is here."""
from pathlib import Path
from cbsr_qa.config import var_folder
def control_socket(station): return str(var_folder() / "control" / f"{station}.sock")
def station_holder(station): return None
