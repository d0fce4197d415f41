"""Runs that are killed at a random moment, resumed, and compared with one that was left alone.

A run is a fork of a process that has loaded everything. It writes the digest of every block of frames to a file once
the journal has committed it. The process that measures, not its parent, is killed with SIGKILL a random moment after
a number of documents.
"""

import os
import signal
import sqlite3
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import command
import forked
import numpy as np

from cbsr_qa.store.opening import open_store
from cbsr_qa.store.runs.journal import Journal
from cbsr_qa.store.types import restore

#: A run of seven loads in two phases, analysed with what is quick to work out.
RECIPE = """
[recipe]
name = "short"
calibrate_phases = ["four places"]

[[phases]]
name = "noise figure"
sequence = "noise-figure"
rest_s = 30.0
frames = 16
strain_percent = 20.0
hold_s = 20.3
trials = 2
recovery_s = 15.0

[[phases]]
name = "four places"
sequence = "location-grid"
strains_percent = [20.0]
locations_mm = [[0.0, 0.0], [20.0, 0.0], [16.0, 9.0], [-20.0, -10.0]]
hold_s = 20.0
rest_s = 15.7
initial_rest_s = 30.0
"""
#: A run of five loads in two phases, which takes two seconds with its result.
BRIEF = """
[recipe]
name = "brief"
calibrate_phases = ["two places"]

[[phases]]
name = "noise figure"
sequence = "noise-figure"
rest_s = 12.0
frames = 16
strain_percent = 20.0
hold_s = 10.0
trials = 1
recovery_s = 12.0

[[phases]]
name = "two places"
sequence = "location-grid"
strains_percent = [20.0]
trials = 2
locations_mm = [[0.0, 0.0], [20.0, 0.0]]
hold_s = 10.0
rest_s = 12.0
initial_rest_s = 10.0
"""
#: A run that decides after each of its presses which one is next: seven, of nine places.
ADAPTIVE = """
[recipe]
name = "deciding"
calibrate_phases = ["long hold", "chosen places"]

[[phases]]
name = "long hold"
sequence = "location-grid"
strains_percent = [20.0]
locations_mm = [[0.0, 0.0]]
hold_s = 20.0
rest_s = 12.0
initial_rest_s = 10.0

[[phases]]
name = "chosen places"
sequence = "adaptive-grid"
target_N = 0.1
at_least = 4
at_most = 7
count = 9
radius_mm = 35.0
strain_percent = 20.0
hold_s = 12.0
rest_s = 11.0
initial_rest_s = 0.0
"""
#: As the one before, briefer, with the plane of three touches and the head just clear of it. Rests last four frames,
#: which are all that is compared of what was before a press.
ADAPTIVE_PLANE = """
[recipe]
name = "deciding over a plane"
calibrate_phases = ["long hold", "chosen places"]

[[phases]]
name = "long hold"
sequence = "location-grid"
strains_percent = [20.0]
locations_mm = [[0.0, 0.0]]
hold_s = 10.0
rest_s = 10.3
initial_rest_s = 3.0
surface = "plane"
touches_mm = [[-30.0, -20.0], [30.0, -20.0], [0.0, 35.0]]
clearance_mm = 3.0

[[phases]]
name = "chosen places"
sequence = "adaptive-grid"
target_N = 0.1
at_least = 4
at_most = 5
count = 9
radius_mm = 35.0
strain_percent = 20.0
hold_s = 5.0
rest_s = 10.3
initial_rest_s = 0.0
find_surface = false
clearance_mm = 3.0
"""
METRICS = ("centre-of-mass-error", "area-overlap", "noise-figure", "channel-noise", "applied-force", "zero-return",
           "repeatability", "load-assignment", "contact-resistance", "creep")  # fmt: skip
#: Effects of the shipped scene without those that remember earlier presses.
STILL = ("sheet-seat", "piezoresistivity", "elastic-stress", "measurement-noise", "load-cell-noise")


#: An effect without memory: a sheet whose response varies by 20 % over 20 mm.
UNEVEN = '[[effects]]\nname = "uneven-response"\ndeviation = 0.2\ncorrelation_mm = 20.0\n'


def write_files(folder, *, memory=False, recipe=RECIPE, more_effects="", emulated=False):
    """Write station, scene and recipe of a quick run.

    Parameters
    ----------
    memory : the scene relaxes as the shipped one.
    emulated : the station's drivers are those of a real bench, and the sensor has eight electrodes: a quarter of the
        readings. The load cell's lines are stamped as they come: one that states its own time is put on the station's
        clock by the lines of the last minute, and no two sessions have the same.
    """
    from cbsr_qa.config.documents import DocumentKind, open_document

    scene, *effects = open_document(DocumentKind.SCENE, "base").text.split("[[effects]]")
    kept = [one for one in effects if memory or any(f'"{name}"' in one for name in STILL)]
    scene = scene.replace("sheet_mesh_size_mm = 6.0", "sheet_mesh_size_mm = 9.0").replace('"base"', '"quick"')
    (folder / "quick.toml").write_text("[[effects]]".join([scene, *kept]) + more_effects)
    station = open_document(DocumentKind.STATION, "bench-emulated" if emulated else "simulated").text
    station = station.replace('scene = "base"', 'scene = "quick.toml"')
    if emulated:
        sensor = open_document(DocumentKind.SENSOR_TYPE, "disc-100mm").text
        (folder / "eight.toml").write_text(sensor.replace("disc-100mm", "eight").replace("count = 16", "count = 8"))
        station = station.replace('sensor_type = "disc-100mm"', 'sensor_type = "eight.toml"')
        station = station.replace('"serial-load-cell"', '"serial-load-cell"\ntime = "arrival"')
    (folder / "station.toml").write_text(station)
    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    middle = shipped[shipped.index("[reconstruction]") : shipped.index("[metrics]")]
    metrics = "[metrics]\n" + "".join(f"{name} = {{}}\n" for name in METRICS)
    limit = '\n[[limits]]\nmeasurement = "centre_of_mass_error"\nunit = "mm"\nupper = 6.5\n'
    (folder / "recipe.toml").write_text(recipe + middle + metrics + command.FEW_SECTIONS + limit)


BEGIN = ("run", "--station", "station.toml", "--recipe", "recipe.toml", "--seed", "5", "--json")


def killed(folder, arguments, *, documents, after_s, limit_s=300):
    """Run a command in a fork that is killed some time after so many documents; returns whether it was."""
    out = [Path(folder) / name for name in ("out", "err")]
    process = command._forks().Process(
        target=_with_a_killer, args=(str(folder), list(arguments), out, documents, after_s)
    )
    process.start()
    process.join(timeout=limit_s)
    assert process.exitcode is not None, f"it has not ended after {limit_s} s"
    said = out[1].read_text()
    if process.exitcode == 3 and "the process of the run was killed by SIGKILL" in said:
        return True
    assert process.exitcode in (0, 1), (process.exitcode, said)
    return False


def strike(folder, arguments, *, at, number, after_s=0.0):
    """Run a command in a fork that is sent a signal some time after a moment; returns what became of it.

    Parameters
    ----------
    at : the moment: how many before it, or its name. Moments are documents of the journal, stages by their names, and
        whatever is stored and written after them (:data:`WRITTEN`), each as it begins and as it ends.
    number : of the signal.
    """
    out = [Path(folder) / name for name in ("out", "err")]
    process = command._forks().Process(
        target=_with_a_striker, args=(str(folder), list(arguments), out, at, number, after_s)
    )
    process.start()
    process.join(timeout=300)
    assert process.exitcode is not None, f"{arguments} has not ended after 300 s"
    return Struck(process.exitcode, out[1].read_text())


@dataclass(frozen=True)
class Struck:
    """How a command ended that was struck, and what it said."""

    code: int
    said: str

    @property
    def done(self):
        """Whether the run has its result: it passed or failed, or an earlier command had stored its result."""
        return self.code in (0, 1) or (self.code == 2 and "is finished, and has its result" in self.said)


#: What is stored and written after a run was computed.
WRITTEN = ("save", "write_calibration", "write_report")


def _with_a_striker(folder, arguments, out, at, number, after_s):
    from cbsr_qa.app.run import outputs
    from cbsr_qa.store.results.analyses import Analyses
    from cbsr_qa.system.clock import Stages

    passed, told = 0, os.open(f"{folder}/moments", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)

    def pass_moment(name):
        nonlocal passed
        os.write(told, b".")
        if at in (passed, name):
            if after_s:
                threading.Timer(after_s, os.kill, (os.getpid(), number)).start()
            else:
                os.kill(os.getpid(), number)
        passed += 1

    def watch(place, name):
        act = getattr(place, name)

        def acted(*given, **named):
            pass_moment(given[1] if name == "announce" else name)
            done = act(*given, **named)
            pass_moment(f"{name} done")
            return done

        setattr(place, name, acted)

    for place, name in zip((Analyses, outputs, outputs), WRITTEN, strict=True):
        watch(place, name)
    watch(Journal, "__call__")
    watch(Stages, "announce")
    forked.run(Path(folder), arguments, {"CBSR_QA_VAR": "var"}, *out)


def _with_a_killer(folder, arguments, out, documents, after_s):
    count = 0
    stored = Journal.__call__
    told = os.open(f"{folder}/committed", os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def counted(self, event):
        nonlocal count
        stored(self, event)
        count += 1
        if type(event).__name__ == "FramesTaken":
            os.write(told, event.frames.voltages.tobytes()[:8] + event.frames.time_s.tobytes()[:8])
        if count == documents:
            threading.Timer(after_s, os.kill, (os.getpid(), signal.SIGKILL)).start()

    Journal.__call__ = counted
    forked.run(Path(folder), arguments, {"CBSR_QA_VAR": "var"}, *out)


@dataclass(frozen=True)
class Came:
    """What came of a run: its record, and measurements and verdict as they are stored."""

    record: object
    measurements: list
    verdict: tuple


def came_of(folder, run, file="var/cbsr-qa.db"):
    """Load a run with its latest result."""
    path = Path(folder) / file
    with open_store(f"sqlite:///{path}", create=False) as store:
        record = store.runs.load(run)
    with sqlite3.connect(path) as database:
        latest = database.execute("select max(analysis) from analyses where run = ?", (run,)).fetchone()
        columns = "name, qualifier, phase, location, trial, value, uncertainty, outcome"
        measured = f"select {columns} from measurements where analysis = ? order by number"
        verdict = "select outcome, reason from analyses where analysis = ?"
        return Came(
            record, database.execute(measured, latest).fetchall(), database.execute(verdict, latest).fetchone()
        )


def latest_run(folder, serial):
    """Return the latest run of a sensor, or None where none was stored."""
    path = Path(folder) / "var" / "cbsr-qa.db"
    if not path.exists():
        return None
    with sqlite3.connect(path) as database:
        if not database.execute("select 1 from sqlite_master where name = 'runs'").fetchall():
            return None
        return database.execute("select max(run) from runs where serial = ?", (serial,)).fetchone()[0]


def frames_of_loads(record):
    """Yield (phase, load, its frames and samples) with times from the press on."""
    for phase in record.phases:
        for load in phase.loads:
            frames = phase.frames.select_interval(load.press_start_s, load.rest_end_s)
            force = phase.channel("force").select_interval(np.nextafter(load.press_start_s, np.inf), load.rest_end_s)
            times = frames.time_s - load.press_start_s, force.time_s - load.press_start_s
            before = phase.frames.select_interval(phase.started_s, load.press_start_s).voltages[-4:]
            yield (phase.name, load.index, load.load), (frames.voltages, *times, force.values, before)


def assert_same(one, other):
    """Frames, force and times of every load, measurements and verdict are the same in every bit."""
    for (place, arrays), (other_place, others) in zip(
        frames_of_loads(one.record), frames_of_loads(other.record), strict=True
    ):
        assert place == other_place
        for array, again in zip(arrays, others, strict=True):
            np.testing.assert_array_equal(array, again, err_msg=str(place))
    assert one.measurements == other.measurements
    assert one.verdict == other.verdict
    assert [replace(made, time_s=0.0) for made in one.record.decisions] == [
        replace(made, time_s=0.0) for made in other.record.decisions
    ]


def assert_nothing_lost(folder, run):
    """Every block of frames that was said to be committed is stored, each once."""
    written = (Path(folder) / "committed").read_bytes()
    said = [written[at : at + 8] for at in range(0, len(written), 16)]
    with sqlite3.connect(Path(folder) / "var" / "cbsr-qa.db") as database:
        row = "select voltages, frames * drives * measures * 8, sha256 from frame_blocks where run = ?"
        rows = database.execute(row, (run,)).fetchall()
        loads = database.execute("select phase, load_index from loads where run = ?", (run,)).fetchall()
    stored = [restore(voltages, size, 8)[:8] for voltages, size, _ in rows]
    assert len(stored) - len(said) in (0, 1, 2, 3), (len(stored), len(said))  # a kill between commit and saying so
    for one in set(said):
        assert stored.count(one) >= said.count(one)
    assert len({digest for *_, digest in rows}) == len(rows)  # times are part of it
    assert len(set(loads)) == len(loads)


def trial(folder, serial, whole, random, *, kills=2, documents=(260, 160), limit_s=300):
    """Kill a run some times at random moments, resume it each time, and compare it with the whole one.

    Parameters
    ----------
    documents : of the journal, before which the first session is killed, and each later one.
    limit_s : longest time of one session.
    """
    (Path(folder) / "committed").unlink(missing_ok=True)
    arguments, run = (*BEGIN, "--serial", serial), None
    for _ in range(kills):
        killed_at = random.randrange(1, documents[0] if run is None else documents[1])
        after_s = random.uniform(0.0, 0.02)
        if not killed(folder, arguments, documents=killed_at, after_s=after_s, limit_s=limit_s):
            break
        run = latest_run(folder, serial)
        if run is not None:
            arguments = ("run", "--resume", run, "--json")
    else:
        if not killed(folder, arguments, documents=-1, after_s=0.0, limit_s=limit_s):
            run = run or latest_run(folder, serial)
    run = latest_run(folder, serial)
    came = came_of(folder, run)
    assert_nothing_lost(folder, run)
    assert_same(whole, came)
    return came


def left_alone(folder):
    """Make a brief run that nobody interrupts; return what came of it, and how many moments it has."""
    write_files(folder, recipe=BRIEF)
    assert strike(folder, [*BEGIN, "--serial", "whole"], at=-1, number=0).code == 0
    return came_of(folder, latest_run(folder, "whole")), (folder / "moments").stat().st_size


#: Where a run is struck half of the time: where its result is computed, stored and written.
_CONCLUDING = ("reading the run back", "imaging", "metrics", "writing the calibration file", "rendering the report",
               *WRITTEN, *(f"{name} done" for name in WRITTEN))  # fmt: skip


def interrupted(folder, whole, moments, random):
    """Strike a brief run, and what resumes it, at random moments; resume it until it has its result.

    The first strike comes without delay: a run that is nearly measured would end before a later one.

    Returns
    -------
    How many processes were struck in all.
    """
    write_files(folder, recipe=BRIEF)
    arguments, struck = [*BEGIN, "--serial", "S-1"], 0
    for _ in range(random.randint(1, 4)):
        at = random.choice((random.randrange(moments), random.choice(_CONCLUDING)))
        number = random.choice((signal.SIGKILL, signal.SIGTERM))
        delay_s = random.choice((0.0, random.uniform(0.0, 0.05)))
        came = strike(folder, arguments, at=at, number=number, after_s=delay_s if struck else 0.0)
        if came.done:
            break
        assert came.code == 3, came
        struck += 1
        if (run := latest_run(folder, "S-1")) is not None:
            arguments = ["run", "--resume", run, "--json"]
    while not came.done:
        came = strike(folder, arguments, at=-1, number=0)
        assert came.done, came
    run = latest_run(folder, "S-1")
    command.cbsr_qa(folder, "report", run)
    check_come_through(folder, run, whole)
    return struck


def check_come_through(folder, run, whole):
    """A run has the result of one that was left alone, its files, and nothing is left to do."""
    came = came_of(folder, run)
    assert_same(whole, came)
    status = command.document(command.cbsr_qa(folder, "db", "status", "--json"))
    assert [status[key] for key in ("incomplete", "stopped", "without_result")] == [[], [], []]
    assert len(list((Path(folder) / "var" / "calibrations").glob(f"*{run}.h5"))) == 1
    (listed,) = command.document(command.cbsr_qa(folder, "runs", "--json"))["runs"]
    assert (listed["verdict"], listed["reason"]) == whole.verdict
