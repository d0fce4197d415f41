"""The pages of the documentation: what they show, and their commands typed as printed."""

import re
import subprocess
from pathlib import Path

from command import PROGRAM, cbsr_qa

TOP = Path(__file__).resolve().parents[2]
HOW_TO = TOP / "docs" / "how-to"


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
