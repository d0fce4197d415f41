"""The catalogue of texts: nothing is missing, nothing is left over."""

import re
from pathlib import Path

import cbsr_qa.web
from cbsr_qa.domain.results import EndReason, Outcome
from cbsr_qa.web.state import Mode
from cbsr_qa.web.texts import keys

_ROOM = Path(cbsr_qa.web.__file__).parent
_CALL = re.compile(r"""\b(?:t|text)\(\s*["']([a-z]+\.[a-z_]*)["']( ?[~+])?""")
_OF_CODE = re.compile(r"""["']((?:control|health)\.[a-z_]+)["']""")


def test_pages_use_the_catalogue_and_all_of_it():
    used, begun = set(), set()
    for file in (*_ROOM.rglob("*.py"), *_ROOM.rglob("*.j2")):
        source = file.read_text()
        for key, joined in _CALL.findall(source):
            (begun if joined else used).add(key)
        used |= set(_OF_CODE.findall(source))
    complete = {key for key in used if not key.endswith(".")}
    assert complete <= keys(), sorted(complete - keys())
    assert {f"mode.{mode}" for mode in Mode} <= keys()
    kinds = {str(one).replace(" ", "_") for one in (*Outcome, EndReason.ABORTED, EndReason.BROKEN)} | {"none"}
    assert {f"{group}.{kind}" for group in ("outcome", "todo") for kind in kinds} <= keys()
