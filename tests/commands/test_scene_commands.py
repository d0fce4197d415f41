"""``cbsr-qa scene``: what its two commands print and write."""

import hashlib
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from command import PROGRAM, cbsr_qa, document, refused
from made_once import copy_of, made_once
from scene_samples import HEAD, load_table

from cbsr_qa.analysis.recording_files import read_recording
from cbsr_qa.config.documents import DocumentKind, list_shipped, open_document
from cbsr_qa.config.loader import load_scene_plan
from cbsr_qa.domain.readings.frames import ReadingFlag
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa_plugins.registry import BUILT_IN

#: Shipped scenes; one of them is in ``make test``.
SCENES = [
    pytest.param(name, marks=[] if name == "base" else pytest.mark.rest) for name in list_shipped(DocumentKind.SCENE)
]
_EFFECTS = """[[effects]]
name = "sheet-seat"
error_mm = 0.05

[[effects]]
name = "time-skew"

[[effects]]
name = "piezoresistivity"

[[effects]]
name = "elastic-stress"

[[effects]]
name = "measurement-noise"

[[effects]]
name = "frame-loss"
share = 0.2

[[effects]]
name = "watchdog-dump"
period_s = 5.0
"""
SHORT = (
    HEAD.replace('"mine"', '"short one"').replace("duration_s = 100.0", "duration_s = 50.0")
    + load_table(x_mm=20.0, y_mm=5.0, hold_s=15.0)
    + load_table(x_mm=-44.0, start_s=22.0, hold_s=10.0, head=2)
    + _EFFECTS
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "short.toml").write_text(SHORT)
    return tmp_path


def _sha(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


# --- run ---


@pytest.fixture(scope="module", params=SCENES)
def shipped(request, tmp_path_factory):
    def make(folder):
        folder.with_suffix(".json").write_text(cbsr_qa(folder, "scene", "run", request.param, "--json").stdout)

    name = f"scene {request.param}"
    folder = copy_of(name, make, tmp_path_factory.mktemp(request.param))
    return request.param, folder, json.loads(made_once(name, make).with_suffix(".json").read_text())


def test_every_shipped_scene_runs(shipped):
    name, folder, said = shipped
    plan = load_scene_plan(name).value
    (file,) = said["files"]
    assert (file["format"], file["path"]) == ("cbsr-recording", f"var/scenes/{name}-seed7.h5")
    sensor_type = "strip-40x20mm" if name == "strip" else "disc-100mm"
    assert (said["scene"], said["seed"], said["sensor_type"], said["material"]) == (name, 7, sensor_type, "cbsr-8wt")
    assert said["frames"] == plan.frame_count
    assert said["effects"] == [choice.name for choice in plan.scene.effects]
    assert set(plan.scene.not_modelled) < set(said["not_modelled"])
    recording = read_recording(folder / file["path"])
    assert len(recording.frames) == said["frames"] - said["frames_lost"]
    assert recording.sensor_type == sensor_type
    assert recording.simulated[0].startswith(f"scene {name}, seed 7, cbsr-qa ")
    assert {block.channel for block in recording.samples} == {"force", "x", "y", "z"}
    assert [(load.load.x_mm, load.load.y_mm) for load in recording.loads] == [load.place_mm for load in plan.loads]
    assert [load["label"] for load in said["loads"]] == [f"L{k}" for k in range(len(plan.loads))]
    limited = (recording.frames.flags & ReadingFlag.COMPLIANCE) > 0
    # One reading while a pin bounces; in every frame all of the two drive pairs of an electrode that is open.
    assert limited.sum() == {"everything": 1, "faulty-electrode": 32 * len(recording.frames)}.get(name, 0)


def test_analyse_finds_the_loads_of_every_shipped_scene(shipped):
    """Without being told where or when: each load has its event, at its time and at its place."""
    name, folder, said = shipped
    if name == "strip":
        pytest.skip("two pins make no images to find loads in")
    found = document(cbsr_qa(folder, "analyse", said["files"][0]["path"], "--no-report", "--json"))["events"]
    presses = [event for event in found if event["sign"] == 1]
    assert len(presses) == len(said["loads"])
    for event, load in zip(presses, said["loads"], strict=True):
        middle_s = (load["hold_start_s"] + load["release_start_s"]) / 2
        assert event["start_s"] < middle_s < event["end_s"]
        assert np.hypot(event["x_mm"] - load["x_mm"], event["y_mm"] - load["y_mm"]) < 2.5, load["label"]
    # With every effect on, a release may be found beside them; the command warns that it may be one.
    assert len(found) == len(presses) or name == "everything"


@pytest.mark.rest
def test_the_same_scene_and_seed_give_the_same_bytes(folder):
    formats = ("--format", "ert-board-csv")
    for name, fresh in (("one", False), ("two", True)):
        cbsr_qa(folder, "scene", "run", "short.toml", *formats, "--output", f"{name}.h5", fresh=fresh)
    assert _sha(folder / "one.h5") == _sha(folder / "two.h5")
    assert _sha(folder / "one.ert-board-csv.csv") == _sha(folder / "two.ert-board-csv.csv")
    other = document(cbsr_qa(folder, "scene", "run", "short.toml", "--seed", "8", "--json"))
    assert other["files"][0]["path"] == "var/scenes/short-one-seed8.h5"
    assert _sha(folder / "var/scenes/short-one-seed8.h5") != _sha(folder / "one.h5")


@pytest.mark.rest
def test_what_a_run_prints_ends_with_what_to_try(folder):
    done = cbsr_qa(folder, "scene", "run", "short.toml", "--format", "ert-board-csv", fresh=True)
    printed = " ".join(done.stdout.split())
    assert "short one, seed 7" in printed
    assert "ert-board-csv var/scenes/short-one-seed7.ert-board-csv.csv" in printed
    assert "loads[2]: the head (13 mm diameter) at (-44, 0) mm is partly over the sheet's edge" in printed
    assert done.stdout.splitlines()[-1] == "try: cbsr-qa analyse var/scenes/short-one-seed7.h5"
    assert "simulating 20 frames" in done.stderr


@pytest.mark.rest
def test_a_sensor_of_ones_own_is_found_beside_the_scene_and_named_to_analyse(folder):
    shipped = open_document(DocumentKind.SENSOR_TYPE, "patch-120x80mm").text
    (folder / "my own.toml").write_text(shipped.replace("patch-120x80mm", "disc-100mm"))  # not the shipped one
    (folder / "short.toml").write_text(SHORT.replace('"disc-100mm"', '"my own"'))
    said = cbsr_qa(folder, "scene", "run", "short.toml").stdout.splitlines()[-1]
    assert said.endswith("short-one-seed7.h5 --sensor-type 'my own.toml'")
    found = document(cbsr_qa(folder, *shlex.split(said)[2:], "--no-report", "--json"))
    assert found["recording"]["frames"] > 0


@pytest.fixture(scope="module")
def short():
    """A folder with the short scene and its recording, and the document of the run; nobody may write into it."""

    def make(folder):
        (folder / "short.toml").write_text(SHORT)
        (folder / "run.json").write_text(cbsr_qa(folder, "scene", "run", "short.toml", "--json").stdout)

    folder = made_once("short scene", make)
    return folder, json.loads((folder / "run.json").read_text())


def test_the_document_of_a_run_has_the_truth_of_every_load(short):
    folder, said = short
    assert set(said) == {
        "scene", "seed", "sensor_type", "material", "frames", "frames_lost", "dumps", "duration_s", "loads", "files",
        "effects", "not_modelled", "analyse",
    }  # fmt: skip
    first, second = said["loads"]
    assert (first["head"], first["touch_s"], first["remark"]) == (1, 20.0, None)
    assert (second["head"], second["x_mm"]) == (2, -44.0)
    assert "over the sheet's edge" in second["remark"]
    assert 15.0 < first["true_strain_percent"] < 25.0  # the sheet lies off nominal
    assert first["true_strain_percent"] != first["strain_percent"]
    recording = read_recording(folder / said["files"][0]["path"])
    assert (said["frames"], len(recording.frames)) == (20, 20 - said["frames_lost"])
    assert said["duration_s"] == pytest.approx(50.0 + 0.075 * said["dumps"])
    assert said["dumps"] > 0


@pytest.mark.rest
def test_only_effects_that_are_on_are_imported(folder):
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from cbsr_qa.studies.scenes.run import SceneRunRequest, run_scene\n"
        "run_scene(SceneRunRequest('short.toml', Path('x.h5')))\n"
        "found = [m for m in sys.modules if m.startswith('cbsr_qa_plugins.effects.')]\n"
        "print(*sorted(m.rpartition('.')[2] for m in found if not m.rpartition('.')[2].startswith('_')))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    on = {choice.name for choice in load_scene_plan(folder / "short.toml").value.scene.effects}
    families = {target.partition(":")[0].rpartition(".")[2] for kind, name, target in BUILT_IN if name in on}
    assert done.stdout.split() == sorted(families)


@pytest.mark.parametrize(
    ("arguments", "reason", "remedy"),
    [
        (["--format", "ert-board"], "no recording plugin named 'ert-board'", "did you mean 'ert-board-csv'"),
        (["--format", "eidors-mat"], "'eidors-mat' is read-only", "writable: cbsr-recording, ert-board-csv"),
        (["--output", "short.toml"], "short.toml exists already", "name another file"),
        (["--output", "short.toml/x.h5"], "cannot be written to", "another folder with --output"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_simulated(folder, arguments, reason, remedy):
    said = refused(folder, "scene", "run", "short.toml", *arguments)
    assert reason in said
    assert remedy in said
    assert "simulating" not in said
    assert not (folder / "var").exists() or not list((folder / "var").rglob("*.h5"))


def test_a_recording_is_never_overwritten(short):
    folder, _ = short
    before = _sha(folder / "var/scenes/short-one-seed7.h5")
    assert "short-one-seed7.h5 exists already" in refused(folder, "scene", "run", "short.toml")
    assert _sha(folder / "var/scenes/short-one-seed7.h5") == before


def test_a_format_that_cannot_hold_the_scene_leaves_no_file(folder):
    """The board steps measure pairs faster; this scene's readings were taken in the other order."""
    turned = SHORT.replace('name = "time-skew"', 'name = "time-skew"\ninner = "drive"')
    (folder / "turned.toml").write_text(turned)
    said = refused(folder, "scene", "run", "turned.toml", "--format", "ert-board-csv")
    assert "cannot be written as ert-board-csv" in said
    assert not (folder / "var").exists()


@pytest.mark.rest
@pytest.mark.parametrize("stage", ["simulating", "writing"])
def test_ctrl_c_is_said_and_leaves_no_file(folder, stage):
    """The signal comes as the stage begins; the program's last word is that it was aborted (exit code 3)."""
    # Long enough that on a busy computer too it is not over before the signal comes.
    long = SHORT.replace("duration_s = 50.0", "duration_s = 40000.0").replace("2.5", "1.0")
    (folder / "long.toml").write_text(long.split("[[effects]]")[0])
    command = [PROGRAM, "scene", "run", "long.toml", "--format", "ert-board-csv"]
    environment = {**os.environ, "CBSR_QA_VAR": "var"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A shell's background jobs, as these tests may be, hand it down that Ctrl-C is ignored.
    listening = partial(signal.signal, signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(command, cwd=folder, env=environment, preexec_fn=listening, **pipes) as process:  # noqa: PLW1509
        for line in process.stderr:
            if line.startswith(stage):
                break
        process.send_signal(signal.SIGINT)
        said, last = process.communicate(timeout=60)
    assert (process.returncode, said) == (3, "")
    assert last.endswith("cbsr-qa: aborted\n")
    assert not (folder / "var").exists()


# --- explain ---


@pytest.mark.parametrize("name", SCENES)
def test_explain_lists_every_effect_on_or_off(tmp_path, name):
    done = cbsr_qa(tmp_path, "scene", "explain", name, "--no-measure", "--json")
    said = document(done)
    on = [choice.name for choice in load_scene_plan(name).value.scene.effects]
    installed = discover().names(Kind.EFFECT)
    assert [effect["name"] for effect in said["effects"]] == on + sorted(set(installed) - set(on))
    assert [effect["name"] for effect in said["effects"] if effect["on"]] == on
    for effect in said["effects"]:
        assert set(effect) == {
            "name", "on", "needs", "perturbs", "cost_ms_per_frame", "parameters", "does", "each_ms", "once_ms",
        }  # fmt: skip
        assert effect["cost_ms_per_frame"] == (None if effect["on"] else 0)
        assert effect["perturbs"]
        assert len(effect["does"]) > 10
    assert said["scene"] == name
    assert any("acceleration of the head" in what for what in said["not_modelled"])
    assert list(tmp_path.iterdir()) == []


def test_explain_measures_what_effects_cost(folder):
    said = document(cbsr_qa(folder, "scene", "explain", "short.toml", "--json"))
    costs = {effect["name"]: effect["cost_ms_per_frame"] for effect in said["effects"] if effect["on"]}
    assert len(costs) == 7
    assert all(0 <= cost < 1e3 for cost in costs.values())  # however busy the computer is
    assert max(costs.values()) > 0
    assert said["frames"] == 20
    assert said["compute_s"] > 0
    skew = next(effect for effect in said["effects"] if effect["name"] == "mains-hum")
    assert (skew["needs"], skew["perturbs"], skew["on"]) == (["time-skew"], "voltages", False)


@pytest.mark.rest
def test_explain_prints_parameters_costs_and_what_is_off(folder):
    lines = cbsr_qa(folder, "scene", "explain", "short.toml").stdout.splitlines()
    assert max(map(len, lines)) <= 100
    assert re.match(r"– 7 of \d+ effects on: a frame takes [\d.]+ ms; 20 frames of the recording about ", lines[0])
    assert any(re.fullmatch(r" *geometry +sheet-seat +[\d.< ]+ once +error_mm = 0.05", line) for line in lines)
    assert any(re.fullmatch(r" *voltages +measurement-noise +[\d.< ]+#*", line) for line in lines)
    off, not_modelled = lines.index("Off"), lines.index("Not modelled")
    assert any(line.strip().startswith("mains-hum ") for line in lines[off:not_modelled])


def test_a_wrong_scene_is_refused_by_both_commands(folder):
    (folder / "wrong.toml").write_text(SHORT.replace("x_mm = 20.0", "x_mm = 90.0"))
    for command in ("run", "explain"):
        said = refused(folder, "scene", command, "wrong.toml")
        for words in ("wrong.toml has 1 problem", "loads[1].x_mm is 90", "the sheet ends 50 mm from its centre"):
            assert words in said
