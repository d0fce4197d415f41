"""What users and other programs rely on stays as it was, unless a change is meant."""

import difflib

import pytest
from manifest import FOLDER, SUBJECTS, spell_subject


@pytest.mark.parametrize("subject", SUBJECTS)
def test_what_others_rely_on_is_unchanged(subject):
    stored = (FOLDER / f"{subject}.json").read_text(encoding="utf-8").splitlines()
    present = spell_subject(subject).splitlines()
    changes = list(difflib.unified_diff(stored, present, "tests/manifest", "the program", lineterm="", n=2))
    assert not changes, "if it is meant: python tests/manifest/manifest.py\n" + "\n".join(changes[:60])
