"""Pages and messages are in plain technical English: phrases that read as translated are named by file and line."""

import ast
import re

import pytest
from pages import TOP
from tiers import rest_but_named

_PAGES = [*sorted(TOP.glob("*.md")), *sorted((TOP / "docs").rglob("*.md"))]

#: Regular expression, in which a space is any white space, and what to write instead.
_BANNED = {
    r"\bmost of (it|this|that) are\b": "most of it is",
    r"\b(is|are|was|were) none\b": "say what is allowed, or 'there is no …'",
    r"\bwhere (there )?(is|are|was|were) none\b": "if there is no …",
    r"\b(by|of) nobody\b|\bnobody named\b": "without a name, unknown",
    r"\bnobody (asked|knows|noted|said|says|states|stated)\b": "unknown, not stated, not recorded",
    r"\b(which|and that|and it) (is|are) (then )?said\b|\b(is|are) said too\b": "the report says so",
    r"\bsays? (?-i:not)\b": "does not say",
    r"\bis there and is (not|no)\b": "already exists and is not",
    r"\bwritten over\b": "overwritten",
    r"\bmend(s|ed|ing)?\b": "fix, correct, repair",
    r"\b(held|holds?|holding) (\w+ ){0,2}against\b": "check against, compare with",
    r"(?<![\w-])whoever\b": "anyone who, the operator",
    r"(?<=[.:;])\s+who (can|forgets|gives|has|knows|may|reads|uses|wants|writes)\b": "anyone who, if you",
    r"\bc(omes?|ame|oming) of\b": "comes from, results from",
    r"\bof (its|their) own\b(?! \w)|\ban? [\w-]+ of (its|their) own\b": "its own …, a separate …",
    r"\ban? metric's\b": "of a metric",
    r"\b(in|by) (no|any|each|every) figure\b|\bfigure by figure\b|\bfigures (differ|agree)\b": "value",
    r"\bnumbers come about\b": "results are computed",
    r"\b(afresh|anew)\b": "again",
    r"\bof before\b": "earlier, old",
    r"\b(refused|left out) by name\b": "refused, and the message names it",
    r"\bit is another( one)?\b(?! \w)": "it has another value",
    r"\b(is|are|was|were) held to\b": "is checked against",
    r"\b(to be|is|are|was|were) told (of|about|anything)\b|\b(could|can|cannot) be told\b(?! apart)": "known, shown",
    r"\bcan be had\b": "is possible",
    r"\b(this |it )?goes on\b": "continues",
    r"\bnobody (answers|is there|measures|retires|sets)\b": "name who or what does not",
    r"\bno(thing|ne)? vouch": "it is unknown whether",
    r"\bdrawn towards a common\b": "shrunk towards",
    r"\bone (row|line|value|frame|number|map) a \w+\b": "one … per …",
    r"\b(is|are) alike but for\b": "are proportional, differ only in",
    r"\bwould be (an)?others?\b": "would change, would differ",
    r"\basks? (the|its) checks\b": "runs the checks",
    r"\bThis page (writes|builds|finds|makes)\b": "This page shows how to …",
    r"\b(suffix|ending) (of the file )?says the format\b|\bis said by the\b": "determines",
    r"\ba test compares\b": "leave it out",
    r"\bmakes? no lot\b|\bis no (list|name|outline|dataset|zero)\b": "is not a …",
}


def _prose(page):
    """A page without code and targets of links, line by line as it was; of a module, what it prints."""
    if page.suffix == ".py":
        return _messages(ast.parse(page.read_text(encoding="utf-8")))

    def blank(found):
        return re.sub(r"[^\n]", " ", found[0])

    return re.sub(r"^```.*?^```|`[^`]*`|\]\([^)]*\)", blank, page.read_text(encoding="utf-8"), flags=re.M | re.S)


def _messages(module):
    """Texts of a module that are no docstrings, on their lines; what an f-string fills in is left out."""
    docstrings = {node.value for node in ast.walk(module) if isinstance(node, ast.Expr)}
    texts = [node for node in ast.walk(module) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    lines = {}
    for node in texts:
        if node not in docstrings and " " in node.value:
            lines[node.lineno] = lines.get(node.lineno, "") + " … " + node.value.replace("\n", " ")
    return "\n".join(lines.get(number, "") for number in range(1, max(lines, default=0) + 1))


def _banned(page):
    text = _prose(page)
    for phrase, instead in _BANNED.items():
        for found in re.finditer(phrase.replace(" ", r"\s+"), text, re.I):
            line = text.count("\n", 0, found.start()) + 1
            yield f"{page.relative_to(TOP)}:{line}: {' '.join(found[0].split())!r}; write: {instead}"


_MODULES = sorted(path for folder in ("cbsr_qa", "plugins") for path in (TOP / folder).rglob("*.py"))


@pytest.mark.parametrize("texts", rest_but_named({"pages": _PAGES, "messages": _MODULES}, "pages"))
def test_no_page_or_message_reads_as_translated(texts):
    found = [line for page in texts for line in _banned(page)]
    assert not found, "\n".join(found)
