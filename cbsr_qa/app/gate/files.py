"""The files of a run: released by somebody, with just this content."""

from cbsr_qa.app.gate.request import Asked, Finding
from cbsr_qa.config import FileContent, configured_files
from cbsr_qa.store import Repository


def files_released(asked: Asked) -> Finding:
    """Look for files whose content nobody released, or whose release was withdrawn."""
    files = configured_files(asked.configuration)
    missing = [one for one in files if not _released(asked.store, one)]
    if not missing:
        return Finding(True, f"all {len(files)} files are released")
    named = ", ".join(
        f"{one.kind} {one.name} ({_state(asked.store, one)}, SHA-256 {one.sha256[:12]})" for one in missing
    )
    return Finding(False, named, "have each released", "cbsr-qa release FILE --by NAME --why TEXT")


def _released(store: Repository | None, file: FileContent) -> bool:
    found = None if store is None else store.latest_release(file.kind, file.sha256)
    return found is not None and found.action == "released"


def _state(store: Repository | None, file: FileContent) -> str:
    found = None if store is None else store.latest_release(file.kind, file.sha256)
    return "not released" if found is None else f"withdrawn by {found.by}"
