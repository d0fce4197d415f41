"""The catalogue of texts: nothing is missing, nothing is left over."""

import re
from pathlib import Path

import cbsr_qa.web
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.listed import ALTERED
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.web.state import Mode
from cbsr_qa.web.texts import keys

_ROOM = Path(cbsr_qa.web.__file__).parent
_KEY = re.compile(r"""["']([a-z]+\.[a-z_]+)["']""")


def test_pages_use_the_catalogue_and_all_of_it():
    sources = [file.read_text() for file in (*_ROOM.rglob("*.py"), *_ROOM.rglob("*.j2"))]
    named = {key for source in sources for key in _KEY.findall(source)}
    asked = {key for source in sources for key in re.findall(r"""\b(?:t|text)\(["']([a-z]+\.[a-z_]+)["']""", source)}
    kinds = {str(one).replace(" ", "_") for one in (*Outcome, EndReason.ABORTED, EndReason.BROKEN, ALTERED)}
    kinds |= {"none", "interrupted", "emergency"}
    joined = {f"{group}.{kind}" for group in ("outcome", "todo") for kind in kinds}
    joined |= {"outcome.running", "outcome.standing", *(f"mode.{mode}" for mode in Mode)}
    joined |= {f"failed.{kind}" for kind in ("fail", "not_measured", "marginal")}
    joined |= {f"scanned.{kind}" for kind in ("may", "again", "refused")} | {"todo.unsafe"}
    joined |= {f"station.{mode}" for mode in (Mode.STARTING, Mode.CONCLUDING, Mode.HELD)}
    assert asked | joined <= keys(), sorted((asked | joined) - keys())
    assert keys() <= named | joined, sorted(keys() - named - joined)
