"""Every hook says when it is called, and what each of its arguments is."""

import inspect
import re

import pytest

from cbsr_qa.plugin import hooks

HOOKS = [function for name, function in vars(hooks).items() if name.startswith("cbsr_")]


def undocumented(function):
    """Return the arguments that no line of the docstring describes; all of them where there is none."""
    described = re.findall(r"^(\w+(?:, \w+)*) : \S", inspect.getdoc(function) or "", re.M)
    names = {name for line in described for name in line.split(", ")}
    return [name for name in inspect.signature(function).parameters if name not in names]


@pytest.mark.parametrize("hook", HOOKS, ids=lambda hook: hook.__name__)
def test_a_hook_and_its_arguments_are_documented(hook):
    assert inspect.getdoc(hook).strip()
    assert undocumented(hook) == []


def test_an_argument_without_documentation_is_found():
    def hook(first, second):
        """Do something.

        first : described.
        """

    assert undocumented(hook) == ["second"]
