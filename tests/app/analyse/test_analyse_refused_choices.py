"""Reconstructions and options that ``cbsr-qa analyse`` refuses, and how options are read."""

import json

import pytest
from pressed_files import exported, pressed_frames

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.cli.options import plugin_options
from cbsr_qa.domain.errors import ConfigError


@pytest.fixture(autouse=True)
def own_var(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    return exported(tmp_path_factory.mktemp("pressed"), pressed_frames(0.4, 0.3, contrast=-0.1))


def run(capsys, *arguments):
    code = run_guarded(["analyse", *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("name", [pytest.param("total-variation", marks=pytest.mark.rest), "absolute-gauss-newton"])
def test_an_image_that_does_not_converge_is_a_refusal_and_nothing_is_written(pressed, tmp_path, capsys, name):
    code, out, err = run(capsys, pressed, "--json", "--reconstruction", name, "--option", "iterations=1")
    document = json.loads(out)
    assert code == 2
    assert document["refused"]["reason"].startswith(name)
    assert "did not converge" in document["refused"]["reason"]
    assert document["refused"]["remedy"]
    assert document["recording"]["frames"] == 80
    assert document["events"] == []
    assert name in err
    assert not (tmp_path / "var").exists()


@pytest.mark.parametrize(
    ("arguments", "said", "remedy"),
    [
        (("--reconstruction", "grait"), "no reconstruction plugin named 'grait'", "did you mean 'greit'?"),
        (("--reconstruction", ""), "no reconstruction plugin named ''", "installed: absolute-gauss-newton"),
        (
            ("--reconstruction", "greit", "--option", "noise_figur=1"),
            "noise_figur is not a known key",
            "did you mean 'noise_figure'? allowed here: hyperparameter, indenter_diameter_mm",
        ),
        (("--option", "noise_figure=low"), "noise_figure is 'low'", "a number above 0"),
        (("--option", "noise_figure"), "not of the form KEY=VALUE", "KEY=VALUE"),
        (("--option", "=1"), "not of the form KEY=VALUE", "KEY=VALUE"),
        (("--option", "noise_figure="), "has no value", "KEY=VALUE"),
        (("--option", "noise_figure=nan"), "not a finite number", "KEY=VALUE"),
        (("--option", "noise_figure=1", "--option", "noise_figure=2"), "given twice", "once"),
    ],
)
def test_bad_choices_are_refused_with_one_document_and_nothing_written(
    pressed, tmp_path, capsys, arguments, said, remedy
):
    code, out, err = run(capsys, pressed, "--json", *arguments)
    refused = json.loads(out)["refused"]
    assert code == 2
    assert said in refused["reason"]
    assert remedy in refused["remedy"]
    assert said in err
    assert not (tmp_path / "var").exists()


def test_a_bad_choice_is_refused_for_every_file_before_one_is_read(pressed, tmp_path, capsys):
    code, out, err = run(capsys, pressed, pressed, "--json", "--reconstruction", "grait")
    assert code == 2
    assert ["grait" in document["refused"]["reason"] for document in json.loads(out)["files"]] == [True, True]
    assert "reading" not in err


def test_options_are_values_as_a_recipe_holds_them():
    given = ["a=1", "b = 0.5", "c=[8, 13.5]", "d=true", "e=gcv", 'f="1"', "g=1\nh=2", "i=x=y"]
    assert plugin_options(given) == {
        "a": 1, "b": 0.5, "c": [8, 13.5], "d": True, "e": "gcv", "f": "1", "g": "1\nh=2", "i": "x=y"
    }  # fmt: skip
    with pytest.raises(ConfigError, match="not a finite number"):
        plugin_options(["a=[1, inf]"])
