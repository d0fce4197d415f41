"""A simulated sensor with a calibration, in a database: what certificates are issued from. Made once."""

import re
import shutil
from pathlib import Path

import cbsr_qa._stations
from certificates import laboratory_table
from made_once import made_once

from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor

_SHIPPED = Path(cbsr_qa._stations.__file__).parent
STANDARDS = """
[standards.load_cell]
certificate = "K-7"
laboratory = "D-K-1"
date = "2026-01-31"
due = "2099-03-31"
uncertainty = 0.2
k = 2.0
unit = "%"
"""
_LIMIT = """
[[limits]]
measurement = "force_error_sd"
unit = "N"
upper = {upper}
qualifier = "place known"
"""


def write_recipe(path, upper_N=0.6):
    """Write a recipe of nine places and five random loads, which judges force alone."""
    text = (_SHIPPED / "recipes" / "nine-locations.toml").read_text()
    for name in ("noise figure", "relaxation"):
        text = re.sub(rf'\[\[phases\]\]\nname = "{name}".*?(?=\n\[)', "", text, flags=re.DOTALL)
    head, _, _ = text.partition('# "Chosen by us" limits')
    head = re.sub(r"\[metrics\]\n.*", "[metrics]\nforce-error = {}\n", head, flags=re.DOTALL)
    path.write_text(head.replace("count = 10", "count = 5") + _LIMIT.format(upper=upper_N))


def write_station(path, table=None, standards=STANDARDS):
    """Write a simulated station with standards and a laboratory."""
    shipped = (_SHIPPED / "simulated.toml").read_text()
    bare = re.sub(r"\[certificate\].*?\n(?=\[)", "", shipped, flags=re.DOTALL)
    path.write_text(f"{bare}{standards}\n{laboratory_table() if table is None else table}")


def _make(folder):
    write_recipe(folder / "recipe.toml")
    write_station(folder / "station.toml")
    request = RunRequest(
        station=str(folder / "station.toml"),
        recipe=str(folder / "recipe.toml"),
        serial="S-1",
        batch="B7",
        operator="Zoë",
        database=str(folder / "runs.db"),
    )
    outcome = run_sensor(request, Unattended()).result
    assert outcome.calibration is not None, outcome.calibration_why


def copy_tested(folder, monkeypatch):
    """Copy the database of a sensor that passed to a folder, and work there; returns the database."""
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "var"))
    kept = made_once("certified runs", _make)
    for name in ("runs.db", "station.toml", "recipe.toml"):
        shutil.copy(kept / name, folder / name)
    return folder / "runs.db"
