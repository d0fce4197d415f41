"""Recordings of scenes as they are handed to what writes them: made up, and simulated."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from simulated_setting import MOTION, scene, truth, world

from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.plan.scene_plan import SceneLoad, ScenePlan
from cbsr_qa.domain.plan.world import SceneSetting, Transcript
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, SampleBlock, ScanKind, VoltageUnit
from cbsr_qa.domain.readings.loads import Indenter, Load, LoadRecord
from cbsr_qa.simulate.recording import record_scene
from cbsr_qa_plugins.recordings.cbsr_recording import CbsrRecording
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv
from cbsr_qa_plugins.recordings.smu_rig_csv import SmuRigCsv

FORMATS = {"cbsr-recording": CbsrRecording, "ert-board-csv": ErtBoardCsv, "smu-rig-csv": SmuRigCsv}
LAB = ["ert-board-csv", "smu-rig-csv"]
PERIOD_S = 2.5
CURRENT_A = 4e-4
HEAD = Indenter(13.0)
SIMULATED = ("scene test; seed 1",)
#: Which pair steps faster on the rig of a format.
INNER = {"ert-board-csv": "measure", "smu-rig-csv": "drive"}


@lru_cache
def setting():
    sensor_type, material = load_sensor_type("disc-100mm").value, load_material("cbsr-8wt").value
    return SceneSetting(sensor_type, material, HEAD, 1, CURRENT_A, PERIOD_S)


def middles_s(count):
    return (np.arange(count) + 0.5) * PERIOD_S


def scan_offsets_s(inner):
    """When each reading of a frame is taken, from its middle."""
    order = np.arange(256).reshape(16, 16)
    return (((order if inner == "measure" else order.T) + 0.5) / 256 - 0.5) * PERIOD_S


def volts(count, seed=3):
    """Readings that all differ, those of the driven pairs much larger than the others, as on a sheet."""
    readings = np.random.default_rng(seed).normal(0, 0.1, (count, 16, 16))
    readings[:, np.arange(16), np.arange(16)] += 7.0
    return readings


def channels(count):
    """Force and place at 8 a second, none of them constant."""
    time_s = np.arange(int(count * PERIOD_S * 8) + 1) / 8
    ramp = time_s / time_s[-1]
    columns = (("force", "N", 4 * ramp), ("x", "mm", 10 * ramp), ("y", "mm", -20 * ramp), ("z", "mm", -3 * ramp))
    return tuple(SampleBlock(name, unit, time_s, values) for name, unit, values in columns)


def made_up(count, *, inner=None, readings=None, flags=None, lost=(), dumps=()):
    """A recording and its transcript.

    Parameters
    ----------
    inner : which pair steps faster; None for frames that are taken at once.
    lost : (frame, first row, row behind the last) of each run of lost rows.
    """
    time_s = middles_s(count)
    transcript = Transcript.complete(setting(), time_s)
    for frame, first, behind in lost:
        transcript.lost[frame, first:behind] = True
    transcript.dumps += dumps
    pauses_s = transcript.pauses_s()
    own = None
    if inner is not None:
        own = time_s[:, None, None] + scan_offsets_s(inner) + pauses_s[:, :, None]
    block = FrameBlock(
        time_s + pauses_s[:, 8],
        volts(count) if readings is None else readings,
        np.zeros((count, 16, 16), np.uint8) if flags is None else flags,
        VoltageUnit.VOLT,
        CURRENT_A,
        own,
    )
    load = LoadRecord(0, Load("L0", 1.0, -2.0, 0.2, 1), 5.0, 6.2, 15.0, 16.2, 20.0)
    recording = Recording(
        Path(), "cbsr-recording", "", ScanKind.FULL, block, None, False, False, "station", channels(count), (load,),
        layout=setting().sensor_type.electrodes, sensor_type="disc-100mm", notes=("one remark",), simulated=SIMULATED,
    )  # fmt: skip
    return recording, transcript


def simulated_press(inner):
    """One press of 20 % on a noisy sheet that is read reading by reading, by a rig that loses rows and dumps logs.

    Returns the recording, its transcript, and the true relative change of the conductance under the head.
    """
    dumping = ("watchdog-dump",) if inner == "measure" else ()
    effects = ("piezoresistivity", "elastic-stress", "time-skew", "measurement-noise", "frame-loss", *dumping)
    options = {"time_skew": {"inner": inner}, "frame_loss": {"share": 0.1}, "watchdog_dump": {"period_s": 15.0}}
    of = replace(scene(*effects, **options), current_A=CURRENT_A)
    load = SceneLoad(20.0, 15.0, 0.2, 60.0, 45.0)
    one = world(of)
    made = record_scene(one, ScenePlan(of, indenter=HEAD, motion=MOTION, seed=1, duration_s=150.0, loads=(load,)))
    change = truth(one, 80.0)[0].relative_change
    return replace(made.recording, simulated=SIMULATED), made.transcript, change
