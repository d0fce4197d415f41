"""The pages of the documentation: what they show, and their commands typed as printed."""

import re
import subprocess
from pathlib import Path

import pytest
from command import PROGRAM, cbsr_qa

TOP = Path(__file__).resolve().parents[2]
HOW_TO = TOP / "docs" / "how-to"

#: Pages with commands, and the test that types them as printed.
TYPED = {
    "README.md": "system/test_documentation.py",
    "docs/how-to/bring-up-a-station.md": "system/test_documentation.py",
    "docs/how-to/build-this-bench.md": "system/test_documentation.py",
    "docs/how-to/characterise-a-material.md": "system/test_characterisation.py",
    "docs/how-to/choose-a-recipe.md": "system/test_documentation.py",
    "docs/how-to/describe-a-sensor.md": "system/test_documentation.py",
    "docs/how-to/propose-limits.md": "system/test_limits_commands.py",
    "docs/how-to/sign-runs.md": "system/test_documentation.py",
    "docs/how-to/simulate-a-scene.md": "system/test_documentation.py",
    "docs/how-to/use-a-calibration.md": "system/test_calibration_page.py",
    "docs/how-to/verify-a-fielded-sensor.md": "system/test_documentation.py",
    "docs/how-to/watch-a-station.md": "unit/test_station_pages.py",
    "docs/how-to/what-to-do-when-it-stops.md": "system/test_resume.py",
    "docs/reference/recordings.md": "system/test_documentation.py",
    "docs/tutorials/your-first-recipe.md": "system/test_tutorials.py",
}
#: Pages that take too long for ``make test``, and what is tested there instead; ``make soak`` types them as printed.
SHORTENED = {
    "docs/how-to/check-numerical-stability.md": "cases made by hand",
    "docs/how-to/compare-batches.md": "the fleet is built in the process of the test",
    "docs/how-to/reproduce-the-paper.md": "figures made by hand in place of simulated sensors",
}

_DECIMAL = re.compile(r"\d+\.\d+")


def blocks(page, language):
    """Return the fenced blocks of a language on a page."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def commands(page):
    """Return what a page tells its reader to type, line by line."""
    return [line[2:] for block in blocks(page, "console") for line in block.splitlines() if line.startswith("$ ")]


def write_files(page, folder):
    """Write the files that a page shows below their names; returns the names."""
    named = re.findall(r"`([\w-]+\.toml)`:\n\n```toml\n(.*?)^```", page.read_text(), re.M | re.S)
    for name, content in named:
        (folder / name).write_text(content)
    return [name for name, _ in named]


def typed(folder, line, **options):
    """Run one line of a page as printed: the shell reads its words, and :func:`command.cbsr_qa` runs them."""
    assert not set("|&;<>$`") & set(line), f"{line}: a command alone"
    read = subprocess.run(
        ["bash", "-c", f"printf '%s\\0' {line}"], cwd=folder, capture_output=True, text=True, check=True
    )
    program, *arguments = read.stdout.split("\0")[:-1]
    assert program == PROGRAM.name, line
    return cbsr_qa(folder, *arguments, **options)


def in_full(page):
    """Return what only ``make soak`` types of a page: what is shortened, and ``--quick`` commands without it."""
    lines = commands(TOP / page)
    shortened = lines if page in SHORTENED else []
    return [*shortened, *(line.replace(" --quick", "") for line in lines if "--quick" in line)]


def assert_printed(shown, printed):
    """What a page shows is on the screen: dots stand for anything, last digits of decimals may differ."""
    shown, printed = (" ".join(words.split()) for words in (shown, printed))
    pattern = re.escape(_DECIMAL.sub("#", shown)).replace(r"\#", r"(\d+\.\d+)").replace("…", ".*?")
    found = re.search(rf"(?<!\S){pattern}(?!\S)", printed)
    assert found, f"{shown}\nis not what was printed:\n{printed}"
    for stated, computed in zip(_DECIMAL.findall(shown), found.groups(), strict=True):
        assert float(stated) == pytest.approx(float(computed), rel=0.05), shown
