"""The files of a certificate: page, XML and signature, in one folder, named by its number."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.certificate_records import IssuedCertificate
from cbsr_qa.system.files import write_atomically, writing

HTML: Final = ".html"
DCC: Final = ".xml"
SIGNATURE: Final = ".signature.json"


def list_contents(issued: IssuedCertificate) -> dict[str, bytes]:
    """Return the content of each file of a certificate, by the end of its name."""
    contents = {HTML: issued.html, DCC: issued.dcc}
    return contents if issued.signature is None else contents | {SIGNATURE: issued.signature.encode()}


def check_absent(folder: Path, number: str) -> None:
    """Refuse to replace a file of a certificate. RefusedError names it."""
    for ending in (HTML, DCC, SIGNATURE):
        if (path := folder / f"{number}{ending}").exists():
            raise RefusedError(f"{path} exists already; a certificate is never replaced by another file")


@contextmanager
def write_files(folder: Path, number: str, contents: Mapping[str, bytes]) -> Iterator[dict[str, Path]]:
    """Write the files of a certificate; they are removed if the block raises. Yield their paths by the same keys.

    RefusedError if a file exists, or cannot be written; none is there then.
    """
    check_absent(folder, number)
    made = not folder.exists()
    paths = {ending: folder / f"{number}{ending}" for ending in contents}
    try:
        for ending, path in paths.items():
            with writing(path, remedy="make the folder writable, or name another"):
                folder.mkdir(parents=True, exist_ok=True)
                with write_atomically(path) as file:
                    file.write(contents[ending])
        yield paths
    except BaseException:
        for path in paths.values():
            with suppress(OSError):  # what kept it from being written may also keep it from being looked for
                path.unlink(missing_ok=True)
        if made:
            with suppress(OSError):  # others may have written to it meanwhile
                folder.rmdir()
        raise
