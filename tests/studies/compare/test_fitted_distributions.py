"""``cbsr-qa compare --distribution``: what is fitted, shown, and refused."""

import json
import re
from pathlib import Path

import pytest
from compared_fleets import ERROR
from demo_fleet import demo_fleet

from cbsr_qa.cli.main import run_guarded

KEYS = (Path(__file__).parents[3] / "docs" / "reference" / "station-statistics.md").read_text()


@pytest.mark.rest
def test_a_distribution_is_fitted_drawn_and_documented(tmp_path, capsys):
    page = tmp_path / "page.html"
    arguments = ["compare", "--by", "batch", "--database", f"sqlite:///{demo_fleet()[0]}", "--metric", ERROR]
    arguments += ["--recipe", "each-on-one-station"]
    assert run_guarded([*arguments, "--output", str(page), "--json"]) == 0
    capsys.readouterr()
    figures = page.read_text().count("<svg")
    assert run_guarded([*arguments, "--distribution", "log-normal", "--json", "--output", str(page)]) == 0
    of_groups = {each["group"]: each for each in json.loads(capsys.readouterr().out)["distributions"]}
    assert "subgroups differ" in of_groups["42"]["no_fitted_capability"]
    for name in ("41", "43"):
        fitted = of_groups[name]["fitted_capability"]
        assert (fitted["fit"]["family"], fitted["chosen"], fitted["pp"]) == ("log-normal", "by hand", None)
        assert fitted["ppk"]["low"] < fitted["ppk"]["value"] < fitted["ppk"]["high"]
        assert {*fitted, *fitted["ppm"], *fitted["compared"][0]} - set(re.findall(r"`(\w+)", KEYS)) == set()
    html = page.read_text()
    assert html.count("<svg") == figures + 2
    assert "no distribution was fitted: subgroups differ" in html


def test_nothing_is_fitted_unless_asked(two, capsys):
    run_guarded(["compare", "--by", "batch", "--database", two, "--metric", ERROR, "--json"])
    (first, *_) = json.loads(capsys.readouterr().out)["distributions"]
    assert (first["fitted_capability"], first["no_fitted_capability"]) == (None, None)


def test_unknown_and_repeated_distributions_are_refused(two, capsys):
    start = ["compare", "--by", "batch", "--database", two]
    for given, said in (
        (["--distribution", "wiebull"], "did you mean 'weibull'? allowed: best, normal"),
        (["--distribution", "gamma", "--distribution", "best"], "is stated for all metrics twice"),
        (["--distribution", "noise_flor=gamma"], "noise_flor"),
        (["--metric", ERROR, "--distribution", "noise_floor=gamma"], "not among the metrics to compare"),
    ):
        assert run_guarded([*start, *given]) == 2
        assert said in capsys.readouterr().err
