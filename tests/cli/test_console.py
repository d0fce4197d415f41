"""Consoles of a run: who answers its prompts."""

import io
import sys

import pytest

from cbsr_qa.app.run.console import NOBODY, RunConsole
from cbsr_qa.cli.console import PageOfLine, Terminal
from cbsr_qa.domain.errors import AbortedError


def answers(console: RunConsole) -> tuple[bool, bool]:
    return console.attended, console.asks_by_channel


def test_prompts_are_answered_at_a_terminal_or_over_the_channel_or_not_at_all(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("done\n"))
    assert answers(Terminal()) == (False, False)
    assert answers(PageOfLine()) == (True, True)
    assert answers(NOBODY) == (False, False)


def test_the_page_of_a_line_gives_the_pin_as_the_first_line_of_input(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("4711\nmore\n"))
    assert PageOfLine().read_pin("PIN of Ada") == "4711"
    assert NOBODY.read_pin("PIN of Ada") == ""


def test_a_terminal_says_what_is_done_and_asks_on_stderr(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO("25.8 mm\nstop\n"))
    console = Terminal()
    console.tell("opening the bench")
    assert console.ask("What does the scale say?") == "25.8 mm"
    with pytest.raises(AbortedError, match="the operator, who answered 'stop'"):
        console.ask("What does the scale say?")
    shown = capsys.readouterr()
    assert shown.err.startswith("opening the bench …\n")
    assert shown.out == ""
