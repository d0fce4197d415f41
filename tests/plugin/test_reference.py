"""The reference of plugins is written from their code."""

import json
from pathlib import Path

import pytest

from cbsr_qa.cli import main
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.reference import plugin_reference, reference_page

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "plugins.md"
PLUGINS = discover()


def test_the_page_is_what_the_code_says():
    written = reference_page(PLUGINS, "cbsr-qa")
    assert PAGE.read_text(encoding="utf-8") == written, "run python docs/figures/write_plugin_reference.py"


def test_every_option_of_the_built_in_plugins_is_described():
    for registration in PLUGINS.registrations():
        if registration.distribution == "cbsr-qa":
            plugin = plugin_reference(PLUGINS, registration.kind, registration.name)
            assert all(option.description for option in plugin.options), plugin


def test_show_prints_options_with_units_defaults_and_ranges_and_what_is_measured(capsys):
    assert main.run_guarded(["plugins", "show", "creep"]) == 0
    out = capsys.readouterr().out
    for words in ("from_s", "5.0", "a number above 0 and below 3600", "the stated time", "creep", "%"):
        assert words in out


def test_show_says_what_the_plugin_is_without_markup_of_its_docstring(capsys):
    assert main.run_guarded(["plugins", "show", "keithley-2600"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("✓ keithley-2600 is an instrument plugin\n")
    assert "(role source_meter)" in out
    assert "`" not in out


def test_show_tells_of_every_plugin_of_a_name(capsys):
    assert main.run_guarded(["plugins", "show", "noise-figure", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)["plugins"]
    assert [plugin["kind"] for plugin in shown] == ["sequence", "metric"]
    assert {option["name"] for option in shown[0]["options"]} >= {"rest_s", "strain_percent"}
    assert shown[1]["measures"] == {"noise_figure": "1"}
    assert main.run_guarded(["plugins", "show", "noise-figure", "--kind", "metric", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["plugins"]) == 1


@pytest.mark.parametrize("more", [[], ["--kind", "metric"]])
def test_show_refuses_a_name_that_nobody_registered(capsys, more):
    assert main.run_guarded(["plugins", "show", "creap", *more]) == 2
    assert "did you mean 'creep'?" in capsys.readouterr().err


def test_list_says_what_each_plugin_does_and_names_its_options(capsys):
    assert main.run_guarded(["plugins", "list", "--options", "--json"]) == 0
    plugins = json.loads(capsys.readouterr().out)["plugins"]
    assert not [plugin["name"] for plugin in plugins if not plugin["summary"].strip()]
    (creep,) = (plugin for plugin in plugins if (plugin["kind"], plugin["name"]) == ("metric", "creep"))
    assert "from_s" in [option["name"] for option in creep["options"]]
