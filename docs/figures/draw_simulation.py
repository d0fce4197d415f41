"""Draw the figures of docs/explanation/simulation.md, one for each effect, from the effects themselves.

``python docs/figures/draw_simulation.py [EFFECT...]`` writes ``docs/explanation/figures/<effect>.svg``; without
names, all of them. The same software draws the same bytes.
"""

import sys
import time
from pathlib import Path
from typing import Final

from simulation_figures import electrodes, faults, head, press, readings, recording, sheet
from simulation_figures.look import Draw, as_file

FOLDER: Final = Path(__file__).resolve().parents[1] / "explanation" / "figures"

#: What draws each effect.
FIGURES: Final[dict[str, Draw]] = {
    **sheet.FIGURES,
    **head.FIGURES,
    **press.FIGURES,
    **electrodes.FIGURES,
    **faults.FIGURES,
    **readings.FIGURES,
    **recording.FIGURES,
}


def main(names: list[str]) -> int:
    """Draw some effects, or all; return the exit status."""
    unknown = sorted(set(names) - set(FIGURES))
    if unknown:
        sys.stderr.write(f"no figure of {', '.join(unknown)}; there are {', '.join(FIGURES)}\n")
        return 2
    FOLDER.mkdir(exist_ok=True)
    for name in names or FIGURES:
        begun = time.perf_counter()
        svg = as_file(name, FIGURES[name])
        (FOLDER / f"{name}.svg").write_text(svg, encoding="utf-8")
        sys.stdout.write(f"{name}: {len(svg) / 1024:.0f} kB in {time.perf_counter() - begun:.1f} s\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
