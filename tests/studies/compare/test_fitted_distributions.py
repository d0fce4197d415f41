"""``cbsr-qa compare --distribution``: what is fitted, shown, and refused."""

import json

from compared_fleets import ERROR

from cbsr_qa.cli.main import run_guarded


def test_a_distribution_is_fitted_and_drawn(two, tmp_path, capsys):
    page = tmp_path / "page.html"
    arguments = ["compare", "--by", "batch", "--database", two, "--metric", ERROR, "--distribution", "log-normal"]
    run_guarded([*arguments, "--json", "--output", str(page)])
    for distribution in json.loads(capsys.readouterr().out)["distributions"]:
        fitted = distribution["fitted_capability"]
        if fitted is None:
            assert "subgroups differ" in distribution["no_fitted_capability"]
            continue
        assert (fitted["fit"]["family"], fitted["chosen"]) == ("log-normal", "by hand")
        assert fitted["ppk"]["low"] < fitted["ppk"]["value"] < fitted["ppk"]["high"]
    html = page.read_text()
    assert "Capability by a fitted distribution" in html


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
