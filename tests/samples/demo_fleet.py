"""The fleet of the demonstration, built once for all tests that read it."""

import json

from made_once import made_once
from stored_lots import unchecked_results

from cbsr_qa.studies.fleet_demo import build_fleet


def demo_fleet():
    """Return the file of the fleet's database, which nobody may write to, and the progress that was told."""

    def make(folder):
        counted = []
        with unchecked_results():
            build_fleet(lambda done, of: counted.append((done, of)), path=folder / "fleet-demo.db")
        (folder / "counted.json").write_text(json.dumps(counted))

    folder = made_once("fleet of the demonstration", make)
    return folder / "fleet-demo.db", json.loads((folder / "counted.json").read_text())
