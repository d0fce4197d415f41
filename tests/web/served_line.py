"""A line that is served for tests: two stations on paced clocks, a sequence that asks, an instrument that dies."""

import os
import re
import signal
import subprocess
import time
from pathlib import Path

from command import FEW_SECTIONS, PROGRAM
from PIL import Image

from cbsr_qa.station.control.lock import station_holder
from cbsr_qa.system.pins import hash_pin

_HERE = Path(__file__).parent
TOKEN = "token-of-these-tests-only"

_RECIPE = """
[recipe]
name = "{name}"
calibrate_phases = []
{asks}
[[phases]]
name = "nine locations"
sequence = "location-grid"
strains_percent = [20.0]
trials = 1
locations_mm = {places}
hold_s = 6.0
rest_s = 3.0
initial_rest_s = 10.0
unloaded_frames = 16

[reconstruction]
method = "gauss-newton-noser"
noise_figure = 1.0
exponent = 0.25

[metrics]
area-overlap = {{}}
{sections}
[[limits]]
measurement = "area_overlap"
unit = "%"
lower = {overlap}

[[limits]]
measurement = "area_ratio"
unit = "1"
lower = 0.2
upper = 5.0
"""
_ASKS = """
[[phases]]
name = "questions"
sequence = "asks"

[[phases]]
name = "cover"
sequence = "operator-prompt"
text = "Close the cover."
picture = "cover.png"
"""
#: Station seconds a second of each station.
_SPEEDS = {"bench-1": 20.0, "bench-2": 20.0, "dying": 60.0}
PIN = "4711"
#: Operator whose PIN is guessed: what others type wrongly does not count for him.
GUESSED = "Guessed"
_STATION = (Path(__file__).parents[2] / "stations" / "line-1.toml").read_text()


def until(condition, what, limit_s=20.0):
    """Wait until a condition holds; AssertionError names what was waited for."""
    ends_s = time.monotonic() + limit_s
    while not (found := condition()):
        assert time.monotonic() < ends_s, f"{what}: not within {limit_s} s"
        time.sleep(0.05)
    return found


class ServedLine:
    """``cbsr-qa serve`` in a folder of its own, as an operator's computer has it."""

    def __init__(self, folder):
        self.folder = folder
        self.port = 0
        self._process = None
        self._write()

    @property
    def address(self):
        return f"http://127.0.0.1:{self.port}"

    def start(self):
        """Start the server, at the port it had before; return once it can be opened."""
        stations = [f"--station={name}.toml" for name in _SPEEDS]
        recipes = [f"--recipe={name}.toml" for name in ("five-places", "asking", "strict")]
        arguments = ["serve", *stations, *recipes, f"--port={self.port}", "--token-file=token"]
        with (self.folder / "serve.log").open("ab") as log:
            self._process = subprocess.Popen(
                [PROGRAM, *arguments], cwd=self.folder, env=self._environment(), stdout=log, stderr=log
            )
        address = re.compile(r"open http://127.0.0.1:(\d+)/")
        until(lambda: address.search(self.log()) or self._process.poll() is not None, "the server's address", 120)
        found = address.findall(self.log())
        assert found, self.log()
        self.port = int(found[-1])
        return self

    def log(self):
        return (self.folder / "serve.log").read_text()

    def stop(self, number=signal.SIGTERM):
        """End the server, and nothing else; return its exit code."""
        self._process.send_signal(number)
        code = self._process.wait(20)
        (self.folder / "serve.log").write_text("")
        return code

    def holder(self, station):
        """The process that uses a station, or None."""
        return station_holder(station)

    def kill_run(self, station):
        """Kill the run at a station with all its processes."""
        os.killpg(os.getpgid(self.holder(station).pid), signal.SIGKILL)

    def _environment(self):
        return {**os.environ, "CBSR_QA_VAR": str(self.folder / "var"), "PYTHONPATH": str(self.folder / "site")}

    def _write(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "token").write_text(TOKEN)
        Image.new("RGB", (40, 30), "orange").save(self.folder / "cover.png")
        for name, speed in _SPEEDS.items():
            paced = _STATION.replace("clock_speed = 60.0", f"clock_speed = {speed}")
            station = paced.replace('"line-1"', f'"{name}"')
            if name == "dying":
                station = station.replace('"simulated-bench"', '"dying-bench"')
                station += '\n[gate]\noperator = "refuse"\n'
                for operator in ("Ada", GUESSED):
                    station += f'\n[[gate.operators]]\nname = "{operator}"\npin = "{hash_pin(PIN)}"\n'
            (self.folder / f"{name}.toml").write_text(station)
        five_mm = [[0.0, 0.0], [30.0, 0.0], [-30.0, 0.0], [0.0, 30.0], [0.0, -30.0]]
        # More than a busy machine presses while a page is looked at.
        eight_mm = [*five_mm, [15.0, 15.0], [-15.0, 15.0], [15.0, -15.0]]
        recipes = (
            ("five-places", five_mm, "", 10.0),
            ("asking", eight_mm, _ASKS, 10.0),
            ("strict", five_mm[:2], "", 99.0),  # no sensor passes it
        )
        for name, places, asks, overlap in recipes:
            recipe = _RECIPE.format(name=name, places=places, asks=asks, overlap=overlap, sections=FEW_SECTIONS)
            (self.folder / f"{name}.toml").write_text(recipe)
        site = self.folder / "site" / "asking-1.0.dist-info"
        site.mkdir(parents=True)
        (site / "METADATA").write_text("Metadata-Version: 2.1\nName: asking\nVersion: 1.0\n")
        (site / "entry_points.txt").write_text("[cbsr_qa]\nasking = line_plugin\n")
        (site.parent / "line_plugin.py").write_text((_HERE / "line_plugin.py").read_text())
