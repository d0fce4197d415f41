"""A bench with a hostile plugin installed beside it, and commands that load it; see hostile_plugin.py."""

import shutil
import sqlite3
import time
from pathlib import Path

import forked
import killing
from command import _forks, cbsr_qa, short_recipe


def install(folder):
    """Install the plugin in a folder, with a station and a short recipe that names its metric; return the folder."""
    information = folder / "site" / "hostile-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: hostile\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text("[cbsr_qa]\nhostile = hostile_plugin\n")
    shutil.copy(Path(__file__).with_name("hostile_plugin.py"), folder / "site")
    killing.write_files(folder)  # a scene that is quickly simulated
    short_recipe(folder, metrics=("centre-of-mass-error", "hostile"))
    short_recipe(folder, "without.toml", metrics=("centre-of-mass-error",))
    return folder


FILES = ("--station", "station.toml", "--serial", "S-1", "--seed", "5")


def arguments_of(recipe="short.toml"):
    return ["run", *FILES, "--recipe", recipe, "--json"]


def run_hostile(bench, folder, hostile, *, recipe="short.toml", arguments=(), **options):
    for file in bench.glob("*.toml"):
        shutil.copy(file, folder)
    given = arguments or arguments_of(recipe)
    return cbsr_qa(folder, *given, check=False, HOSTILE=hostile, PYTHONPATH=str(bench / "site"), **options)


def verdicts(folder):
    file = folder / "var" / "cbsr-qa.db"
    if not file.exists():
        return []
    with sqlite3.connect(file) as database:
        return [outcome for (outcome,) in database.execute("select outcome from analyses")]


def start(bench, folder, hostile, *, ignored=(), arguments=()):
    """Start a run in a process group of its own; return the process and where its output goes."""
    for file in bench.glob("*.toml"):
        shutil.copy(file, folder)
    written = folder / "out", folder / "err"
    written[1].touch()  # so that it can be watched
    environment = {"CBSR_QA_VAR": "var", "HOSTILE": hostile, "PYTHONPATH": str(bench / "site")}
    given = (ignored, folder, arguments or arguments_of(), environment, *written)
    process = _forks().Process(target=forked.run_as_a_job, args=given)
    process.start()
    return process, written


def until(condition):
    until_s = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < until_s
        time.sleep(0.05)
