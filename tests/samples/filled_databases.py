"""Databases with many runs in them: what begins like another one is copied from it; a run takes 0.1 s to store."""

import json
import shutil
from pathlib import Path

from made_once import made_once, named_by
from stored_lots import store_run

from cbsr_qa.store.opening import open_store

#: After so many runs more, a database is kept for others that begin alike.
_STEP = 4


def filled(path, runs):
    """Store runs, each (serial, measurements, options of ``store_run``), in a database; returns their names.

    The database may be there already.
    """
    runs, path = list(runs), Path(path)
    return _stored(path, runs, 0 if path.exists() else (len(runs) - 1) // _STEP * _STEP)


def _stored(path, runs, begun):
    """Copy the database of the runs before, and store the others in it."""
    names = []
    if begun > 0:
        kept = made_once(named_by("runs", *runs[:begun]), lambda folder: _kept(folder, runs[:begun], begun - _STEP))
        shutil.copy(kept / "runs.db", path)
        names = json.loads((kept / "names.json").read_text())
    with open_store(f"sqlite:///{path}", durable=False) as store:
        return names + [
            store_run(store, serial, taken, **options) for serial, taken, options in runs[max(begun, 0) :]
        ]


def _kept(folder, runs, begun):
    (folder / "names.json").write_text(json.dumps(_stored(folder / "runs.db", runs, begun)))
