"""A calibrated sensor, recordings and a board of it, and programs that stream its forces."""

import json
import os
import pty
import subprocess
import threading
import time
import tty
from contextlib import contextmanager, suppress

import numpy as np
from command import PROGRAM
from force_calibration import force_calibration, frames
from station_files import station_file

from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, ScanKind, VoltageUnit

#: Of played recordings; a whole number of ticks of the clock.
PERIOD_S = 0.0625
_PLACE = (5.0, 7.0)


def loaded(count, *, off=4, on=8, force_N=3.0):
    """Frames (count, 16, 16) [V], every so many without and with a load."""
    forces = np.where(np.arange(count) % (off + on) < off, 0.0, force_N)
    return frames(np.tile(_PLACE, (count, 1)), forces)


def write_sensor(folder, count=40, *, speed=1.0, sensor_type="disc-100mm"):
    """Write ``sensor.h5``, ``press.h5``, and ``station.toml``, which plays the recording on a clock of this speed."""
    if not (folder / "sensor.h5").exists():
        write_calibration(folder / "sensor.h5", force_calibration())
    seen = loaded(count)
    block = FrameBlock(PERIOD_S * np.arange(count), seen, np.zeros(seen.shape, np.uint8), VoltageUnit.VOLT, 4e-4)
    path = folder / "press.h5"
    path.unlink(missing_ok=True)
    write_recording(
        path,
        Recording(
            path, "cbsr-recording", "", ScanKind.FULL, block, None, False, False, "station", sensor_type=sensor_type
        ),
    )
    table = '[instruments.bench]\ndriver = "replayed-recording"\n'
    table += f'provides = ["frame_source", "force_applicator", "force"]\nfile = "{path}"\n'
    text = station_file("played", table).replace('clock = "virtual"', f'clock = "virtual"\nclock_speed = {speed}')
    (folder / "station.toml").write_text(text)


@contextmanager
def streaming(folder, *arguments, **environment):
    """Start ``cbsr-qa stream``; it is ended with the block."""
    process = subprocess.Popen(
        [str(PROGRAM), "stream", *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "CBSR_QA_VAR": str(folder / "var"), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=60)


def port_of(process):
    """Port that a program says it serves."""
    for line in process.stderr:
        if "tcp://" in line:
            return int(line.rsplit(":", 1)[1])
    raise AssertionError("it ended without serving")


def messages(text):
    """Messages of lines, which hold no NaN; without "alive", which a busy machine sends at any place."""

    def refuse(constant):
        raise AssertionError(f"{constant} in a message")

    parsed = [json.loads(line, parse_constant=refuse) for line in text.splitlines()]
    return [message for message in parsed if message["type"] != "alive"]


class Board:
    """The end of a serial line at which a board sends binary frames; a context manager."""

    period_s = 0.2

    def __init__(self, volts):
        scale = 20000 / np.abs(volts).max()
        counts = (np.rint(volts * scale) + 32768).astype("<u2").reshape(len(volts), -1)
        records = np.full((len(volts), counts.shape[1], 3), ord("\r"), np.uint8)
        records[:, :, :2] = counts[:, :, None].view(np.uint8).reshape(len(volts), -1, 2)
        self._frames = [frame.tobytes() + b"A\r" for frame in records]
        self._master, slave = pty.openpty()
        tty.setraw(slave)
        self.address, self._slave = os.ttyname(slave), slave
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.pull()

    def pull(self):
        """Pull the cable."""
        self._over.set()
        self._thread.join()
        for end in (self._master, self._slave):
            os.close(end)
        self._master = self._slave = os.open(os.devnull, os.O_RDWR)
        self._slave = os.dup(self._slave)

    def _send(self):
        due_s = time.monotonic()
        os.set_blocking(self._master, False)
        while not self._over.is_set():
            for frame in self._frames:
                due_s += self.period_s
                if self._over.wait(max(due_s - time.monotonic(), 0)):
                    return
                with suppress(BlockingIOError):  # nobody reads
                    os.write(self._master, frame)
