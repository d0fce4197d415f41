"""The files of a certificate: page, XML and signature, in one folder, named by its number."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from cbsr_qa.domain.results.certificate_records import IssuedCertificate
from cbsr_qa.system.files import write_atomically, writing

HTML: Final = ".html"
DCC: Final = ".xml"
SIGNATURE: Final = ".signature.json"


def list_contents(issued: IssuedCertificate) -> dict[str, bytes]:
    """Return the content of each file of a certificate, by the end of its name."""
    contents = {HTML: issued.html, DCC: issued.dcc}
    return contents if issued.signature is None else contents | {SIGNATURE: issued.signature.encode()}


def find_taken(folder: Path, number: str) -> Path | None:
    """Return a file of a folder that has a name of a certificate's files; None without one."""
    paths = (folder / f"{number}{ending}" for ending in (HTML, DCC, SIGNATURE))
    return next((path for path in paths if path.exists()), None)


@contextmanager
def write_files(folder: Path, number: str, contents: Mapping[str, bytes]) -> Iterator[dict[str, Path]]:
    """Write the files of a certificate; they get their names when the block ends. Yield their paths by the same keys.

    The block records the certificate: a file that has a name is of one that is recorded, whenever this is killed.

    RefusedError if one cannot be written; none is there then, nor if the block raises.
    """
    made = not folder.exists()
    paths = {ending: folder / f"{number}{ending}" for ending in contents}
    try:
        again = f"`cbsr-qa certificate copy {number} --to FOLDER` writes again what is recorded"
        with writing(folder / number, remedy=again), ExitStack() as named_at_the_end:
            for ending in reversed(paths):  # the signature gets its name last
                with writing(paths[ending], remedy="make the folder writable, or name another"):
                    folder.mkdir(parents=True, exist_ok=True)
                    file = named_at_the_end.enter_context(write_atomically(paths[ending]))
                    file.write(contents[ending])
                    file.flush()  # a full disk is noticed before the certificate is recorded
            yield paths
    except BaseException:
        if made:
            with suppress(OSError):  # others may have written to it meanwhile
                folder.rmdir()
        raise
