"""The pages on backups and on re-analyses, typed as printed after one short run."""

import json

import pytest
from command import QUICK, cbsr_qa, short_recipe
from pages import HOW_TO, commands, typed


@pytest.mark.rest
def test_the_pages_on_backups_and_re_analyses_run_as_printed(tmp_path):
    recipe = short_recipe(tmp_path, metrics=QUICK)
    cbsr_qa(
        tmp_path, "run", "--station", "simulated", "--recipe", recipe, "--serial", "Y-1", "--seed", "1", check=False
    )
    short_recipe(tmp_path, "changed.toml", metrics=QUICK, **{"upper = 6.5": "upper = 0.001"})

    first, again, adopt, changes = commands(HOW_TO / "re-analyse-a-year.md")
    assert "pass" in typed(tmp_path, first).stdout
    stored = json.loads(typed(tmp_path, again).stdout)
    assert (stored["computed"], stored["reused"], stored["flips"][0]["now"]) == (0, 1, "fail")
    assert stored["peak_worker_mb"] is None
    typed(tmp_path, adopt)
    assert "limit of the customer" in typed(tmp_path, changes).stdout
    assert "adopted by Ada" in " ".join(typed(tmp_path, "cbsr-qa report Y-1").stdout.split())

    backup, check, restore = commands(HOW_TO / "back-up-a-station.md")
    for command in (backup, check, restore):
        typed(tmp_path, command)
    assert len(list((tmp_path / "var").glob("cbsr-qa-replaced-*.db"))) == 1
