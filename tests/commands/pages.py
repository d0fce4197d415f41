"""The pages of the documentation: what they show, and their commands typed as printed."""

import re
import subprocess
from pathlib import Path

import pytest
from command import PROGRAM, cbsr_qa

TOP = Path(__file__).resolve().parents[2]
HOW_TO = TOP / "docs" / "how-to"

#: Pages with commands, and the test that types them as printed (in `sign-calibrations.md`, with a shorter recipe).
TYPED = {
    "README.md": "commands/test_documentation.py",
    "docs/how-to/back-up-a-station.md": "commands/test_keeping_pages.py",
    "docs/how-to/bring-up-a-station.md": "commands/test_documentation.py",
    "docs/how-to/bring-your-own-data.md": "commands/test_documentation.py",
    "docs/how-to/build-this-bench.md": "commands/test_documentation.py",
    "docs/how-to/calibrate-from-presses.md": "commands/test_documentation.py",
    "docs/how-to/central-database.md": "commands/test_synchronisation_commands.py",
    "docs/how-to/characterise-a-material.md": "commands/test_characterisation.py",
    "docs/how-to/describe-a-sensor.md": "commands/test_documentation.py",
    "docs/how-to/issue-a-certificate.md": "commands/test_page_of_certificates.py",
    "docs/how-to/propose-limits.md": "commands/test_limits_commands.py",
    "docs/how-to/re-analyse-a-year.md": "commands/test_keeping_pages.py",
    "docs/how-to/sign-calibrations.md": "commands/test_signed_calibrations.py",
    "docs/how-to/sign-runs.md": "commands/test_documentation.py",
    "docs/how-to/simulate-a-scene.md": "commands/test_documentation.py",
    "docs/how-to/stream-forces.md": "commands/test_stream.py",
    "docs/how-to/take-your-data-elsewhere.md": "commands/test_data_elsewhere.py",
    "docs/how-to/use-a-calibration.md": "commands/test_calibration_page.py",
    "docs/how-to/test-more-sensors-an-hour.md": "commands/test_batch_page.py",
    "docs/how-to/verify-a-fielded-sensor.md": "commands/test_documentation.py",
    "docs/how-to/watch-a-station.md": "app/station_check/test_station_pages.py",
    "docs/how-to/what-to-do-when-it-stops.md": "commands/test_resume.py",
    "docs/how-to/write-a-driver.md": "commands/test_plugin_tutorial.py",
    "docs/how-to/write-a-plugin.md": "commands/test_plugin_tutorial.py",
    "docs/reference/recordings.md": "commands/test_documentation.py",
    "docs/tutorials/your-first-plugin.md": "commands/test_plugin_tutorial.py",
    "docs/tutorials/your-first-recipe.md": "commands/test_tutorials.py",
    "docs/tutorials/your-own-bench.md": "commands/test_tutorials.py",
}
#: Pages that take too long for ``make test-all``, and what is tested there; ``make soak`` types them as printed.
SHORTENED = {
    "docs/how-to/check-numerical-stability.md": "cases made by hand",
    "docs/how-to/choose-a-recipe.md": "the table that the next command prints too is printed once",
    "docs/how-to/compare-batches.md": "the fleet is built in the process of the test",
    "docs/how-to/install.md": "its run is the tour's, and tried without moving anything",
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


_MARKED = re.compile(r"<!-- table: (.+?) -->\n\n(.*?)\n\n<!-- end -->", re.S)


def marked_tables(text):
    """Return the rows of every table between markers, by its name: a dict of cells by column each."""
    tables = {}
    for name, table in _MARKED.findall(text):
        columns, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines())
        tables[name] = [dict(zip(columns, row, strict=True)) for row in rows]
    return tables


_FIGURE = re.compile(r"(\d+(?:\.(\d+))?)(e[-+]\d+)?")


def same_words(stated, computed):
    """Whether two cells say the same but for their numbers."""
    return _FIGURE.sub("#", stated) == _FIGURE.sub("#", computed)


def assert_same_figures(stated, computed, where):
    """Two cells say the same: words alike, numbers within 5 % or one in the last digit that is printed."""
    assert same_words(stated, computed), where
    for shown, found in zip(_FIGURE.finditer(stated), _FIGURE.finditer(computed), strict=True):
        last = float(f"1e-{len(shown[2] or '')}") * float(f"1{shown[3] or 'e0'}")
        assert float(shown[0]) == pytest.approx(float(found[0]), rel=0.05, abs=1.01 * last), (where, stated, computed)


#: Columns of ``frontier.md`` that a machine decides, and words of those that are measured on the sheet.
_OF_A_MACHINE = ("set-up", "•", "worth it")
_MEASURED = ("error", "map", "gauge", "settling", "E_CoM", "A_OL", "SD", "missed", "inclusion")
_COSTS = (*_OF_A_MACHINE, "unknowns", "memory", "time")


def assert_same_tables(stated, computed):
    """Marked tables of two pages have the same figures, row by row of the same settings; times of a machine aside."""
    theirs = marked_tables(computed)
    for name, rows in marked_tables(stated).items():
        found = {_settings_of(row): row for row in theirs[name]}
        same = [row for row in rows if _settings_of(row) in found]  # which rows are shown hangs on times
        assert len(same) >= 0.7 * len(rows) > 0, name
        for row in same:
            other = found[_settings_of(row)]
            for column in _told(row):
                assert_same_figures(row[column], other[column], (name, _settings_of(row), column))


def _settings_of(row):
    return tuple(cell for name, cell in row.items() if name not in _COSTS and not any(w in name for w in _MEASURED))


def _told(row):
    """Columns that are no time of a machine and no rounding of sixteen digits."""
    of_station = [name for name in row if name == "time" and "min" in row[name]]
    of_sheet = [name for name in row if name not in (*_OF_A_MACHINE, "time") and not row[name].endswith("e-16")]
    return [*of_sheet, *of_station]
