"""Forces streamed to other programs: how late they are.

``python -m benchmarks.streamed_forces`` measures what docs/how-to/stream-forces.md states: frames of a recording
that is played at 32 Hz, from the end of a frame until a client has its newtons, on one computer, by a calibration
with the physical estimate and by one from labelled presses. Mosquitto must answer at 127.0.0.1:1883.
"""

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.force import issued
from cbsr_qa.analysis.recording_files import read_recording, write_recording
from cbsr_qa.domain.readings.frames import FrameBlock, Recording

_PROGRAM: Final = str(Path(sys.executable).with_name("cbsr-qa"))
_PERIOD_S: Final = 0.03125
_TCP: Final = 9771
_TOPIC: Final = "cbsr-qa/benchmark"
#: What a client does: give every line as it comes.
_Lines = Callable[["subprocess.Popen[bytes]"], Iterator[bytes]]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.streamed_forces", description=__doc__)
    parser.add_argument("--frames", type=int, default=1000)
    frames = parser.parse_args().frames
    print("| calibration | to | p50 | p99 | largest | frames missed |\n| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for calibration, arguments in {
            "of a run (physical estimate)": _of_run(folder, frames),
            "from labelled presses": _of_presses(folder, frames),
        }.items():
            for place, (to, lines) in _PLACES.items():
                late_ms, missed = _measured(folder, [*arguments, "--to", to], lines)
                p50, p99, most = (f"{value:.1f} ms" for value in np.percentile(late_ms, (50, 99, 100)))
                print(
                    f"| {calibration} | {place} | {p50} | {p99} | {most} | {missed} of {len(late_ms)} |", flush=True
                )


def _measured(folder: Path, arguments: list[str], lines: _Lines) -> tuple[list[float], int]:
    """From the end of each frame until its message has come [ms], and the number of frames missed."""
    late_ms, missed = [], 0
    command = [_PROGRAM, "stream", *arguments]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        for line in lines(process):
            now_s = time.monotonic()
            message: Mapping[str, Any] = json.loads(line)
            if message["type"] == "frame":
                late_ms.append(1e3 * (now_s - message["monotonic_s"] - _PERIOD_S / 2))
                missed = message["missed"]
            if message["type"] == "end":
                break
    return late_ms, missed


def _of_output(process: "subprocess.Popen[bytes]") -> Iterator[bytes]:
    assert process.stdout is not None
    yield from process.stdout


def _of_tcp(process: "subprocess.Popen[bytes]") -> Iterator[bytes]:
    while process.poll() is None:
        try:
            connection = socket.create_connection(("127.0.0.1", _TCP))
        except ConnectionRefusedError:
            time.sleep(0.05)
            continue
        with connection, connection.makefile("rb") as lines:
            yield from lines
            return


def _of_broker(process: "subprocess.Popen[bytes]") -> Iterator[bytes]:
    del process
    command = ["mosquitto_sub", "-h", "127.0.0.1", "-t", f"{_TOPIC}/#"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as subscriber:
        assert subscriber.stdout is not None
        try:
            yield from subscriber.stdout
        finally:
            subscriber.terminate()


_PLACES: Final[Mapping[str, tuple[str, _Lines]]] = {
    "standard output": ("-", _of_output),
    "TCP": (f"tcp://127.0.0.1:{_TCP}", _of_tcp),
    "MQTT": (f"mqtt://127.0.0.1/{_TOPIC}", _of_broker),
}


def _played(path: Path, recording: Recording, voltages: np.ndarray, count: int) -> str:
    """Write frames, over and over, at the benchmark's rate; return the driver's option that plays them."""
    frames = recording.frames
    again = np.arange(count) % len(voltages)
    block = FrameBlock(
        _PERIOD_S * np.arange(count), voltages[again], frames.flags[again], frames.unit, frames.current_A
    )
    write_recording(path, replace(recording, path=path, frames=block, loads=(), samples=()))
    return f"file={path}"


def _of_run(folder: Path, count: int) -> list[str]:
    from cbsr_qa.calibration.file.hdf5 import write_calibration

    run = issued()
    write_calibration(folder / "run.h5", run.calibration.issued)
    played = _played(folder / "run-frames.h5", run.recording, run.recording.frames.voltages, count)
    return ["run.h5", "--from", "replayed-recording", "-o", played]


def _of_presses(folder: Path, count: int) -> list[str]:
    """A calibration learned from presses of the shipped disc, by the same model as its frames."""
    sys.path[:0] = ["tests/samples"]
    from pressed_sheets import pressed_sheet  # type: ignore[import-not-found]

    from cbsr_qa.config.loader import load_sensor_type
    from cbsr_qa.domain.readings.frames import ScanKind, VoltageUnit

    pattern = load_sensor_type("disc-100mm").value.pattern
    usable = pattern.usable()
    pairs = np.array([(*pattern.drive[d], *pattern.measure[m]) for d, m in np.argwhere(usable)])
    sheet = pressed_sheet(60, pairs=pairs)
    whole: dict[str, np.ndarray] = {}
    for name, values in {
        "presses": sheet.changes + sheet.unloaded,
        "rest": np.tile(sheet.unloaded, (3, 1)),
    }.items():
        whole[name] = np.zeros((len(values), *pattern.shape))
        whole[name][:, usable] = 1e-3 * values
        block = FrameBlock(
            np.arange(len(values), dtype=float),
            whole[name],
            np.zeros(whole[name].shape, np.uint8),
            VoltageUnit.VOLT,
            1e-3,
        )
        path = folder / f"{name}.h5"
        write_recording(
            path, Recording(path, "cbsr-recording", "", ScanKind.FULL, block, None, False, False, "board")
        )
    labels = sheet.write(folder, labels={"force_N": sheet.force_N})[1]
    command = [
        "calibrate",
        "presses.h5",
        "--presses",
        str(labels),
        "--sensor-type",
        "disc-100mm",
        "--rest",
        "rest.h5",
    ]
    subprocess.run([_PROGRAM, *command, "--to", "pressed.h5"], cwd=folder, check=True, capture_output=True)
    played = _played(folder / "press-frames.h5", read_recording(folder / "presses.h5"), whole["presses"], count)
    return ["pressed.h5", "--from", "replayed-recording", "-o", played]


if __name__ == "__main__":
    main()
