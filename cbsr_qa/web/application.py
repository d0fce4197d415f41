"""The web application: its addresses, and the answers to requests."""

import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from importlib.resources import files
from typing import Final, TypeVar
from urllib.parse import parse_qsl

from anyio import CapacityLimiter, to_thread
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.web.actions import Actions
from cbsr_qa.web.files import calibration_response, prompt_picture, report_response
from cbsr_qa.web.guard import DRAWINGS_POLICY, LOG, Access, Guard, Right, client_of
from cbsr_qa.web.guesses import TooManyGuessesError
from cbsr_qa.web.line import MAX_READ_ONLY_VIEWERS, MAX_VIEWERS, Line, Viewer
from cbsr_qa.web.pages import Pages, Part, picture_address
from cbsr_qa.web.shift import run_page, search_page, sensor_page, shift_page
from cbsr_qa.web.streams import EventStream
from cbsr_qa.web.texts import refusal_words, text

_KINDS: Final = {"css": "text/css", "js": "text/javascript", "svg": "image/svg+xml", "png": "image/png"}
#: Files of the package that are served, read once.
STATIC: Final = (
    "bursts.js",
    "icon.svg",
    "line.css",
    "line.js",
    "marks.js",
    "none.png",
    "operators.js",
    "sound.js",
)
T = TypeVar("T")
_RUN: Final = re.compile(r"[0-9a-f-]{36}")

#: Number of pages made at once for those who may only look, and number of their requests that may wait.
_LOOKER_THREADS: Final = 1
_MAX_WAITING: Final = 16

Endpoint = Callable[[Request], Awaitable[Response]]


def make_application(line: Line, access: Access) -> Guard:
    """Return the application behind its guard."""
    pages = Pages(line)
    actions = Actions(line, pages)
    site = Site(line, pages, access)

    @asynccontextmanager
    async def open_line(app: Starlette) -> AsyncIterator[None]:
        await line.open()
        try:
            yield
        finally:
            await line.close()

    def post(path: str, endpoint: Endpoint) -> Route:
        return Route(path, endpoint, methods=["POST"])

    station = "/stations/{station}"
    viewer_pages = [
        ("/", site.overview),
        ("/events", site.overview_events),
        (station, site.station),
        (f"{station}/events", site.station_events),
        (f"{station}/image/{{run}}/{{frame}}", site.image),
        (f"{station}/prompt/{{number:int}}", site.prompt),
        ("/runs/{run}", site.run),
        ("/runs/{run}/report", site.report),
        ("/runs/{run}/calibration", site.calibration),
        ("/shift", site.shift),
        ("/sensors/{serial}", site.sensor),
        ("/search", site.search),
    ]
    routes = [
        *(Route(path, site.guard_page(endpoint)) for path, endpoint in viewer_pages),
        Route("/static/{name}", site.static),
        Route("/sign-in", site.sign_in, methods=["GET", "POST"]),
        *(
            post(f"{station}/{name}", site.route_to_station(action))
            for name, action in actions.list_actions().items()
        ),
    ]
    error_handlers: dict[type[Exception] | int, Callable[[Request, Exception], Awaitable[Response]]] = {
        HTTPException: site.problem,
        CbsrError: site.refusal,
        Exception: site.broken,
    }
    return Guard(Starlette(routes=routes, lifespan=open_line, exception_handlers=error_handlers), access)


class Site:
    """Answers to requests that change nothing."""

    def __init__(self, line: Line, pages: Pages, access: Access) -> None:
        self._line, self._pages, self._access = line, pages, access
        self._looker_threads = CapacityLimiter(_LOOKER_THREADS)
        folder = files(__package__).joinpath("static")
        self._static = {name: folder.joinpath(name).read_bytes() for name in STATIC}

    def guard_page(self, endpoint: Endpoint) -> Endpoint:
        """Return an endpoint for viewers; others are asked to sign in, and a token in the address signs in."""

        async def endpoint_for_viewers(request: Request) -> Response:
            if "token" in request.query_params:
                return self._sign_in(request, request.query_params["token"], request.url.path)
            if request.scope["cbsr_right"] < Right.LOOK:
                return self._sign_in_page(HTTPStatus.UNAUTHORIZED)
            return await endpoint(request)

        return endpoint_for_viewers

    def route_to_station(self, action: Callable[[str, dict[str, str]], Awaitable[Response]]) -> Endpoint:
        """Return an endpoint for an action, which gets the station and the fields of the form."""

        async def endpoint_for_action(request: Request) -> Response:
            return await action(self._check_station(request), await _form(request))

        return endpoint_for_action

    async def overview(self, request: Request) -> Response:
        return HTMLResponse(self._pages.overview(control=_controls(request)))

    async def station(self, request: Request) -> Response:
        return HTMLResponse(self._pages.station(self._check_station(request), control=_controls(request)))

    async def overview_events(self, request: Request) -> Response:
        return self._events(Viewer(None, _controls(request)), self._pages.overview_parts, lambda: "")

    async def station_events(self, request: Request) -> Response:
        name = self._check_station(request)
        watch = self._line.stations[name]

        def picture() -> str:
            snapshot = watch.snapshot
            return "" if snapshot is None or not snapshot.mode.live else picture_address(snapshot)

        return self._events(Viewer(name, _controls(request)), lambda: self._pages.station_parts(name), picture)

    def _events(self, viewer: Viewer, parts: Callable[[], list[Part]], picture: Callable[[], str]) -> Response:
        read_only_viewers = sum(not open_viewer.control for open_viewer in self._line.viewers)
        may_look = viewer.control or read_only_viewers < MAX_READ_ONLY_VIEWERS
        if len(self._line.viewers) >= MAX_VIEWERS or not may_look:
            LOG.warning("%s", text("refused.streams"))
            return PlainTextResponse(text("refused.streams"), HTTPStatus.SERVICE_UNAVAILABLE)
        return EventStream(self._line, viewer, parts, picture)

    async def image(self, request: Request) -> Response:
        live = self._line.stations[self._check_station(request)].live
        if live is None or live.run != request.path_params["run"] or not live.picture:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return Response(live.picture, media_type="image/png")

    async def prompt(self, request: Request) -> Response:
        channel = self._line.stations[self._check_station(request)].channel
        return await self._run_in_thread(request, prompt_picture, channel, request.path_params["number"])

    async def report(self, request: Request) -> Response:
        return await self._run_in_thread(request, report_response, self._line.database, _run(request))

    async def calibration(self, request: Request) -> Response:
        return await self._run_in_thread(request, calibration_response, self._line.database, _run(request))

    async def shift(self, request: Request) -> Response:
        names, in_progress = tuple(self._line.stations), self._line.runs_in_progress()
        view = await self._run_in_thread(request, shift_page, self._line.database, names, in_progress)
        page = self._pages.page("shift", control=_controls(request), here="shift", **view)
        return HTMLResponse(page, headers={"content-security-policy": DRAWINGS_POLICY})

    async def sensor(self, request: Request) -> Response:
        view = await self._run_in_thread(request, sensor_page, self._line.database, request.path_params["serial"])
        return HTMLResponse(self._pages.page("sensor", control=_controls(request), **view))

    async def run(self, request: Request) -> Response:
        view = await self._run_in_thread(request, run_page, self._line.database, _run(request))
        return HTMLResponse(self._pages.page("run", control=_controls(request), **view))

    async def search(self, request: Request) -> Response:
        wanted = request.query_params.get("q", "").strip()
        view = await self._run_in_thread(request, search_page, self._line.database, wanted)
        status = HTTPStatus.BAD_REQUEST if view["refused"] else HTTPStatus.OK
        return HTMLResponse(self._pages.page("search", control=_controls(request), **view), status)

    async def _run_in_thread(self, request: Request, make: Callable[..., T], *arguments: object) -> T:
        """Call a slow function in a thread, and return its result.

        Viewers who may only look share one thread, so that they take none from those who control, and little of the
        computer. HTTPException if too many of them wait for it.
        """
        if _controls(request):
            return await to_thread.run_sync(make, *arguments)
        if self._looker_threads.statistics().tasks_waiting >= _MAX_WAITING:
            raise HTTPException(HTTPStatus.SERVICE_UNAVAILABLE, text("refused.looks"))
        return await to_thread.run_sync(make, *arguments, limiter=self._looker_threads)

    async def static(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self._static:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return Response(
            self._static[name],
            media_type=_KINDS[name.rpartition(".")[2]],
            headers={"cache-control": "max-age=60"},
        )

    async def sign_in(self, request: Request) -> Response:
        if request.method == "GET":
            return self._sign_in_page(HTTPStatus.OK)
        return self._sign_in(request, (await _form(request)).get("token", ""), "/")

    def _sign_in(self, request: Request, token: str, path: str) -> Response:
        try:
            if self._access.check_token(token, client_of(request.scope)):
                return RedirectResponse(path, HTTPStatus.SEE_OTHER, {"set-cookie": self._access.set_cookie()})
        except TooManyGuessesError as wait:
            words = text("refused.guesses", seconds=wait.wait_s)
            return self._sign_in_page(HTTPStatus.TOO_MANY_REQUESTS, words, {"retry-after": str(wait.wait_s)})
        LOG.warning("a wrong token was given")
        return self._sign_in_page(HTTPStatus.UNAUTHORIZED, text("sign.wrong"))

    def _sign_in_page(self, status: int, why: str = "", headers: dict[str, str] | None = None) -> Response:
        return HTMLResponse(self._pages.page("sign_in", control=True, why=why), status, headers)

    def _check_station(self, request: Request) -> str:
        name = str(request.path_params["station"])
        if name not in self._line.stations:
            station_names = ", ".join(self._line.stations)
            raise HTTPException(
                HTTPStatus.NOT_FOUND, text("problem.no_station", name=repr(name[:64]), known=station_names)
            )
        return name

    async def problem(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        phrase = HTTPStatus(error.status_code).phrase
        words = text("problem.no_page") if error.detail == phrase else error.detail
        return self._problem(request, words, error.status_code)

    async def refusal(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, CbsrError)
        LOG.warning("%s: %s", request.url.path[:120], error.reason)
        return self._problem(request, refusal_words(error), 400)

    async def broken(self, request: Request, error: Exception) -> Response:
        LOG.error("%s", request.url.path[:120], exc_info=error)
        return self._problem(request, text("problem.broken"), 500)

    def _problem(self, request: Request, words: str, status: int) -> Response:
        if request.method == "POST":
            return PlainTextResponse(words, status)
        control = _controls(request)
        title = text("problem.title")
        return HTMLResponse(self._pages.page("problem", control=control, title=title, words=words), status)


def _controls(request: Request) -> bool:
    return bool(request.scope["cbsr_right"] >= Right.CONTROL)


def _run(request: Request) -> str:
    run = str(request.path_params["run"])
    if not _RUN.fullmatch(run):
        raise HTTPException(HTTPStatus.NOT_FOUND, text("problem.no_run"))
    return run


async def _form(request: Request) -> dict[str, str]:
    """Return the fields of a form, each once, without blanks around them."""
    try:
        pairs = parse_qsl((await request.body()).decode(), keep_blank_values=True, max_num_fields=40, errors="strict")
    except ValueError:
        raise HTTPException(HTTPStatus.BAD_REQUEST, text("refused.form")) from None
    return {name: value.strip() for name, value in pairs}
