"""Runs the installed command as a user would."""

import json
import os
import subprocess
import sys
from pathlib import Path

PROGRAM = Path(sys.executable).with_name("cbsr-qa")


def cbsr_qa(folder, *arguments, check=True, **environment):
    """Run one command in a folder; by default it must succeed."""
    done = subprocess.run(
        [str(PROGRAM), *arguments],
        cwd=folder,
        env={**os.environ, "CBSR_QA_VAR": "var", **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    if check and done.returncode:
        raise AssertionError(f"{arguments} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}")
    return done


def document(done):
    """Return the one JSON document a command printed, refusing NaN."""

    def refuse(constant):
        raise AssertionError(f"{constant} in a JSON document")

    return json.loads(done.stdout, parse_constant=refuse)


def short_recipe(folder, name="short.toml", **replacements):
    """Write the shipped recipe with its first phase alone, one trial and short times; returns the file's name."""
    from cbsr_qa.config.documents import DocumentKind, open_document

    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    head, rest = shipped.split("[[phases]]", 1)
    first = rest.split("[[phases]]", 1)[0]
    tail = rest[rest.index("[reconstruction]") : rest.index("[[limits]]")]
    head = head.replace('"nine locations"', '"noise figure"')
    limit = '\n[[limits]]\nmeasurement = "centre_of_mass_error"\nunit = "mm"\nupper = 6.5\n'
    text = head + "[[phases]]" + first.replace("trials = 3", "trials = 1") + tail + limit
    for old, new in replacements.items():
        assert old in text, old
        text = text.replace(old, new)
    (folder / name).write_text(text)
    return name
