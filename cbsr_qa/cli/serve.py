"""``cbsr-qa serve``: the page of a line."""

import webbrowser
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command
from cbsr_qa.cli.options import Database
from cbsr_qa.cli.output import note
from cbsr_qa.domain.errors import RefusedError

#: Libraries of the optional extra for this command.
_NEEDED = ("starlette", "uvicorn", "PIL")


@command("serve")
def serve(
    station: Annotated[list[str], typer.Option(help="Station file, or the name of a shipped one; may be repeated.")],
    recipe: Annotated[
        list[str] | None, typer.Option(help="Recipe to offer; may be repeated. By default the shipped ones.")
    ] = None,
    host: Annotated[str, typer.Option(help="Address to listen on; by default this computer alone.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 for any free one.")] = 8765,
    name: Annotated[
        list[str] | None, typer.Option(help="Name by which other computers reach this one; may be repeated.")
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option(help="TLS certificate (PEM), needed with another --host.")
    ] = None,
    key: Annotated[Path | None, typer.Option(help="Key of the certificate (PEM).")] = None,
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token; by default one is made and kept in var/control.")
    ] = None,
    anyone_may_look: Annotated[
        bool, typer.Option("--anyone-may-look", help="Show the pages without the token; control needs it.")
    ] = False,
    open_browser: Annotated[bool, typer.Option("--open", help="Open the page in a browser.")] = False,
    database: Database = None,
) -> None:
    """Serve a page for the operators of stations: start, watch and stop runs in a browser.

    Each run is a separate process, which goes on when this command ends.
    """
    missing = [library for library in _NEEDED if find_spec(library) is None]
    if missing:
        raise RefusedError(f"serve needs {', '.join(missing)}", remedy="pip install 'cbsr-qa[web]'")
    from cbsr_qa.web.server import ServeRequest, serve

    request = ServeRequest(
        stations=station,
        recipes=recipe or (),
        host=host,
        port=port,
        names=name or (),
        certificate=certificate,
        key=key,
        token_file=token_file,
        anyone_may_look=anyone_may_look,
        database=database,
    )

    def tell(address: str) -> None:
        note(f"open {address}")
        if open_browser:
            webbrowser.open(address)

    serve(request, tell)
