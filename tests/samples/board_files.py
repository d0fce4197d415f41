"""Files as the lab's recorder scripts write them, with every quirk on request."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cbsr_qa.domain.readings.frames import ReadOptions, Recording
from cbsr_qa_plugins.recordings.ert_board_csv import ErtBoardCsv

PAIRS = 16
TITLES = "time_pc [s],Mass [g],time_mcu[ms],data [mV]:"
DUMP = (
    "\x1b[0;31mE (5317) task_wdt: Task watchdog got triggered. These tasks did not reset the watchdog:\x1b[0m",
    "\x1b[0;31mE (5317) task_wdt:  - IDLE (CPU 0)\x1b[0m",
    "",
    "Backtrace:0x400D9DDB:0x3FFB0B800x40082749:0x3FFB0BA0 0x4000BFED:0x3FFB5810 ",
    "",
)


def counts(frames: int, rows: int = PAIRS, seed: int = 1) -> np.ndarray:
    """Whole counts, (frames, rows, 16), all different enough to tell a wrong order."""
    return np.random.default_rng([seed, frames, rows]).integers(-3000, 9000, (frames, rows, PAIRS))


@dataclass
class BoardFile:
    """One recording, written line by line; ``lines`` may be changed before it is saved."""

    mass: bool = True
    clock: bool = True
    lines: list[str] = field(default_factory=list)
    now_s: float = 0.005
    board_ms: int = 170_000
    row_ms: int = 15
    mass_g: float = 0.0

    def header(self) -> "BoardFile":
        self.lines += ["UTC:,2022-04-05 00:26:11.636727", TITLES if self.mass else "Isrc:,105"]
        if not self.mass:
            self.lines.append("time [s],data*0.1 [mV]:")
        return self

    def payload(self, payload: str) -> "BoardFile":
        front = f"{self.now_s!r},{self.mass_g!r}," if self.mass else f"{self.now_s!r},"
        self.lines.append(front + payload)
        return self

    def mark(self) -> "BoardFile":
        return self.payload("A")

    def row(self, values) -> "BoardFile":
        self.now_s += self.row_ms / 1000
        self.board_ms += self.row_ms
        stamp = f"{self.board_ms}," if self.clock else ""
        return self.payload(stamp + ",".join(str(int(v)) for v in values) + ",")

    def rows(self, frame) -> "BoardFile":
        for values in frame:
            self.row(values)
        return self

    def frames(self, block) -> "BoardFile":
        for frame in block:
            self.mark().rows(frame)
        return self

    def log(self, lines=DUMP) -> "BoardFile":
        for line in lines:
            self.payload(line)
        return self

    def save(self, folder: Path, name: str = "recording.csv") -> Path:
        path = folder / name
        path.write_text("\n".join(self.lines) + "\n", encoding="utf-8", newline="")
        return path


#: Five frames.
BLOCK = counts(5)


def read(path: Path) -> Recording:
    """The recording in a file that the format takes for its own."""
    format_ = ErtBoardCsv()
    assert format_.recognises(path, path.read_bytes()[:4096])
    return format_.read(path, ReadOptions())
