"""Commands that a person is told to type next."""

import pytest

from cbsr_qa.app.command_hints import database_option


@pytest.mark.parametrize(
    "url", ["postgresql://lab:hunter2@host:5432/quality", "postgresql://host/quality?user=lab&password=hunter2"]
)
def test_a_database_is_named_without_its_password(url):
    option = database_option(url)
    assert "hunter2" not in option
    assert option.startswith(" --database ")
    assert "/quality" in option


@pytest.mark.parametrize("file", ["var/my runs.db", "sqlite:///var/my runs.db"])
def test_a_file_is_named_as_it_was_given(file):
    assert database_option(file) == f" --database '{file}'"
    assert database_option(None) == ""
