"""Pages and their parts as HTML. A page that is open gets the parts that have changed."""

import hashlib
import json
from dataclasses import dataclass
from time import monotonic
from typing import Any, Final, NamedTuple, Self
from urllib.parse import quote

from jinja2 import Environment, PackageLoader, StrictUndefined

from cbsr_qa.domain.plan.limits import choose_disposition
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.report.tables import limit_text, quantity, value_cell
from cbsr_qa.system.clock import name_zones, write_local_time
from cbsr_qa.web.drawings import Trace, scale_colours, trace
from cbsr_qa.web.gate import GateView
from cbsr_qa.web.line import Line
from cbsr_qa.web.live_run import TRACE_S, LiveView, Place
from cbsr_qa.web.outcomes import (
    SIGNS,
    ago_words,
    cue,
    earlier_words,
    kind_of_result,
    kind_of_sensor,
    reason_words,
    standing_words,
    verdict_kind,
)
from cbsr_qa.web.shift import describe_run
from cbsr_qa.web.start import StartForm
from cbsr_qa.web.state import Mode, Snapshot
from cbsr_qa.web.texts import text

#: Parts of a run in progress, each replaced by itself.
_LIVE_PARTS: Final = ("prompt", "marks", "legend", "step", "controls", "doing", "traces", "places", "notes")
#: Most characters of a text that fit into half a line in the largest letters, and in the middle ones.
_SHORT: Final = 14
_MEDIUM: Final = 28
#: Likewise of a serial number in the largest letters, beside a state.
_SHORT_SERIAL: Final = 10
#: Most limits that a page shows at once; the others are unfolded.
SHOWN_LIMITS: Final = 4


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a page.

    Parameters
    ----------
    place : id of the element it fills.
    key : changes when it must be sent again.
    """

    place: str
    html: str
    key: str

    @classmethod
    def from_html(cls, place: str, html: str, layout: str | None = None) -> Self:
        """Return a part that changes with its HTML, or with the layout given."""
        content = html if layout is None else layout
        return cls(place, html, hashlib.blake2b(content.encode(), digest_size=6).hexdigest())


def size_of(words: str) -> str:
    """Return how large a text can be written in one line: a class of the style sheet."""
    return "short" if len(words) <= _SHORT else "medium" if len(words) <= _MEDIUM else "long"


def size_of_serial(serial: str) -> str:
    """Return how large a serial number can be written beside a state, or below it."""
    return "medium" if _SHORT_SERIAL < len(serial) <= _SHORT else size_of(serial)


def minutes_left(snapshot: Snapshot) -> str:
    """Return the time left in words, to the minute; empty while a run waits or concludes."""
    if snapshot.mode in (Mode.PAUSED, Mode.ASKING, Mode.CONCLUDING):
        return ""
    ends_at = None if snapshot.control is None else snapshot.control.ends_at
    if ends_at is None:
        return text("page.no_estimate")
    left_s = ends_at - monotonic()
    return text("page.less_than_a_minute") if left_s < 60 else f"{round(left_s / 60)} {text('page.minutes')}"


def step_words(snapshot: Snapshot) -> str:
    """Return the press and the step of the run in words."""
    control = snapshot.control
    if control is None:
        return text(f"station.{snapshot.mode}")  # without a run: starting, concluding or held
    # A pause begins before a step, which is then not under way.
    return control.step if control.paused_by is None else ""


def progress_words(snapshot: Snapshot) -> str:
    """Return how far the run has come: the press under way, or the next one, of how many."""
    control = snapshot.control
    if control is None or not control.number:
        return ""
    return text("live.press", number=control.number, of=control.of)


def phase_words(snapshot: Snapshot) -> str:
    """Return the phase with its number."""
    live = snapshot.live
    if live is None or not live.phases:
        return "" if snapshot.control is None else snapshot.control.phase
    phase = live.phases[-1]
    if live.planned_phases == 1:
        return phase.name
    return text("live.phase", phase=phase.name, number=phase.index + 1, of=live.planned_phases)


def list_places(view: LiveView) -> list[Place]:
    """Return one press of each place of the grid: the one under way, else the latest that was seen."""
    place_by_label: dict[str, Place] = {}
    for place in view.places:
        known = place_by_label.get(place.load.label)
        if known is None or place.now or (place.seen is not None and not known.now):
            place_by_label[place.load.label] = place
    return list(place_by_label.values())


def place_kind(place: Place) -> str:
    """Return the kind of a place, a key of :data:`SIGNS`."""
    if place.seen is None:
        return "running" if place.now else "open"
    return "pressed"  # neutral whatever its image: limits judge it once the run is over


def place_words(place: Place) -> str:
    """Return that a place was pressed, and whether it was seen; else whether it is pressed now."""
    if place.seen is None:
        return text("live.now_place") if place.now else text("live.open_place")
    return text("live.unseen" if place.seen.overlap_percent is None else "live.pressed")


def place_numbers(place: Place) -> str:
    """Return overlap and error of a place."""
    preview = place.seen
    if preview is None or preview.overlap_percent is None or preview.error_mm is None:
        return ""
    overlap = text("live.overlap", percent=f"{preview.overlap_percent:.0f}")
    return f"{overlap}, {text('live.error', error=f'{preview.error_mm:.1f}')}"


def force_trace(snapshot: Snapshot) -> Trace:
    """Lay out the force."""
    assert snapshot.live is not None
    return trace(snapshot.live.force_N, TRACE_S, 1.0)


def conductance_trace(snapshot: Snapshot) -> Trace:
    """Lay out the conductance."""
    assert snapshot.live is not None
    return trace(snapshot.live.conductance_percent, TRACE_S, 0.2)


def error_trace(snapshot: Snapshot) -> Trace:
    """Lay out the expected force error since it was first known."""
    assert snapshot.live is not None
    points = snapshot.live.error_N
    return trace(points, max(points[-1][0] - points[0][0], 1.0), 0.1)


def picture_address(snapshot: Snapshot) -> str:
    """Return the address of the latest image; a transparent one before the first."""
    if snapshot.live is None or snapshot.look is None or not snapshot.live.frame:
        return "/static/none.png"
    return f"{_base(snapshot.station)}/image/{snapshot.look.run}/{snapshot.live.frame}"


def report_address(run: str, measurement: Measurement) -> str:
    """Return the address of a limit's row in a report; a browser without text fragments opens the report.

    A row begins with the label and the phase; where loads are told apart by their strain, the label alone is found.
    """
    label, phase = (
        quote(words, safe="").replace("-", "%2D") for words in (measurement.label, measurement.phase or "whole run")
    )
    return f"/runs/{run}/report#:~:text={label},-{phase}&text={label}"


def describe_measured(measurement: Measurement) -> str:
    """Return the value of a judged measurement and how far it is from its nearer bound."""
    value_words, limit, value = value_cell(measurement, unit=True).text, measurement.limit, measurement.value
    if limit is None or value is None:
        return value_words
    margin = limit.margin(value)
    below = limit.lower is not None and value < limit.lower
    side = "limit.inside" if margin >= 0 else "limit.below" if below else "limit.above"
    unit = "percentage points" if measurement.unit == "%" else measurement.unit  # 3.5 % of what?
    return f"{value_words}, {text(side, by=quantity(abs(margin), unit))}"


def number(value: float, digits: int) -> str:
    """Format a value with a fixed number of digits, without a negative zero."""
    formatted = f"{value:.{digits}f}"
    return formatted.removeprefix("-") if not float(formatted) else formatted.replace("-", "−")


def _base(station: str) -> str:
    return f"/stations/{quote(station, safe='')}"


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("cbsr_qa.web"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        auto_reload=False,  # of an upgrade under a running server, the next one takes both templates and code
    )
    environment.globals |= {
        "t": text,
        "signs": SIGNS,
        "trace_minutes": f"{TRACE_S / 60:g}",
        "scale_colours": scale_colours(),
        "verdict_kind": verdict_kind,
        "write_local_time": write_local_time,
        "name_zones": name_zones,
        "cue": cue,
        "choose_disposition": choose_disposition,
        "size_of": size_of,
        "size_of_serial": size_of_serial,
        "ago_words": ago_words,
        "earlier_words": earlier_words,
        "shown_limits": SHOWN_LIMITS,
        "kind_of_result": kind_of_result,
        "kind_of_sensor": kind_of_sensor,
        "standing_words": standing_words,
        "reason_words": reason_words,
        "describe_run": describe_run,
        "minutes_left": minutes_left,
        "step_words": step_words,
        "progress_words": progress_words,
        "list_places": list_places,
        "phase_words": phase_words,
        "place_kind": place_kind,
        "place_words": place_words,
        "place_numbers": place_numbers,
        "force_trace": force_trace,
        "conductance_trace": conductance_trace,
        "error_trace": error_trace,
        "picture_address": picture_address,
        "number": number,
        "limit_text": limit_text,
        "describe_measured": describe_measured,
        "report_address": report_address,
    }
    return environment


class _Rendered(NamedTuple):
    """Parts as they were rendered from a snapshot, with the trouble of the store at that time."""

    snapshot: Snapshot | None
    trouble: str
    parts: list[Part]


class Pages:
    """Renders pages and parts of a line; a part is rendered once for all viewers."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._environment = _environment()
        for template in self._environment.list_templates(extensions=["j2"]):
            self._environment.get_template(template)  # compiled before a run is watched
        self._rendered: dict[str, _Rendered] = {}
        self._cards: dict[str, _Rendered] = {}

    def page(self, template: str, *, control: bool, here: str = "", stream: str = "", **names: Any) -> str:
        """Render a whole page."""
        shared_names = {
            "stations": list(self._line.stations),
            "trouble": self._line.trouble,
            "in_progress": self._line.runs_in_progress(),
            "to_resume": self._line.runs_to_resume(),
        }
        return self._environment.get_template(f"{template}.html.j2").render(
            shared_names | {"control": control, "here": here, "stream": stream, "keys": "{}"} | names
        )

    def fragment(self, part: str, **names: Any) -> str:
        """Render a part."""
        return self._environment.get_template(f"parts/{part}.html.j2").render(names)

    def overview(self, *, control: bool) -> str:
        cards = [
            {"name": name, "snapshot": watch.snapshot, "simulated": watch.served.simulated}
            for name, watch in self._line.stations.items()
        ]
        return self.page("overview", control=control, here="overview", stream="/events", cards=cards)

    def station(self, name: str, *, control: bool) -> str:
        names = self._names(name)
        trouble = self._line.trouble or _trouble(names["s"])
        keys = json.dumps({part.place: part.key for part in self.station_parts(name)})
        stream = f"{_base(name)}/events"
        return self.page(
            "station", control=control, here=name, stream=stream, keys=keys, **names | {"trouble": trouble}
        )

    def gate(self, station: str, wanted: StartForm, view: GateView) -> str:
        """Render the answers of the gate on a sensor before its run."""
        return self.fragment("gate", base=_base(station), request=wanted, view=view)

    def render_wrong_field(self, station: str, serial: str, field: str) -> str:
        """Render that a sensor was scanned with a field of the form that is wrong."""
        return self.fragment("misstated", base=_base(station), serial=serial, field=text(f"station.{field}"))

    def render_scan(self, station: str, serial: str, view: GateView | None) -> str:
        """Render the state of a station at which a sensor was scanned; None: the gate could not be asked."""
        kind = "refused" if view is None or not view.may else "again" if view.asks_again else "may"
        return self.fragment("scanned", name=station, serial=serial, kind=kind)

    def idle_parts(self, name: str) -> list[list[str]]:
        """Return what a scan has replaced on the page of a station, as it was before."""
        names = self._names(name)
        snapshot = names["s"]
        if snapshot is None or snapshot.mode.runs:
            return []
        return [[part, self.fragment(part, **names)] for part in ("state", "refused", "verdict")]

    def overview_parts(self) -> list[Part]:
        """Return the parts of the overview."""
        parts = [self._part("trouble", trouble=self._line.trouble)]
        return [*parts, *(self._card(f"card-{index}", name) for index, name in enumerate(self._line.stations))]

    def _card(self, place: str, name: str) -> Part:
        snapshot = self._line.stations[name].snapshot
        cached = self._cards.get(name)
        if cached is None or cached.snapshot is not snapshot:
            is_simulated = self._line.stations[name].served.simulated
            card = Part.from_html(place, self.fragment("card", s=snapshot, name=name, is_simulated=is_simulated))
            cached = self._cards[name] = _Rendered(snapshot, "", [card])
        return cached.parts[0]

    def station_parts(self, name: str) -> list[Part]:
        """Return the parts of a station's page; the part that contains others comes first."""
        snapshot, trouble = self._line.stations[name].snapshot, self._line.trouble
        cached = self._rendered.get(name)
        if cached is None or cached.snapshot is not snapshot or cached.trouble != trouble:
            cached = self._rendered[name] = _Rendered(snapshot, trouble, self._station_parts(name, snapshot, trouble))
        return cached.parts

    def _station_parts(self, name: str, snapshot: Snapshot | None, trouble: str) -> list[Part]:
        names = self._names(name)
        trouble_part = self._part("trouble", trouble=trouble or _trouble(snapshot))
        if snapshot is None:  # the server has just begun: an open page keeps what it shows
            return [trouble_part]
        parts = [Part.from_html("body", self.fragment("body", **names), _layout(snapshot))]
        parts += [self._part("state", **names), trouble_part]
        if snapshot.mode.live:
            return [*parts, *(self._part(part, **names) for part in _LIVE_PARTS)]
        return parts if snapshot.mode.runs else [*parts, self._part("refused", **names)]

    def _part(self, place: str, **names: Any) -> Part:
        html = self.fragment(place, **names)
        return Part.from_html(place, html)

    def _names(self, name: str) -> dict[str, Any]:
        watch = self._line.stations[name]
        snapshot, recipes = watch.snapshot, watch.served.recipes
        recipe_names = [recipe.name for recipe in recipes]
        last_recipe = "" if snapshot is None or snapshot.look is None else snapshot.look.recipe
        return {
            "s": snapshot,
            "name": name,
            "base": _base(name),
            "recipes": recipes,
            "is_simulated": watch.served.simulated,
            "asks_operator": watch.served.asks_operator,
            "chosen_recipe": last_recipe if last_recipe in recipe_names else recipe_names[0],
        }


def _layout(snapshot: Snapshot | None) -> str:
    """Return a text that changes with the layout of a station's page: a field in use must not be replaced."""
    if snapshot is None:
        return ""
    if snapshot.mode.live:
        return f"live {None if snapshot.live is None else snapshot.live.sheet}"
    if snapshot.mode.runs:
        return str(snapshot.mode)
    look = snapshot.look
    return f"idle {snapshot.mode} {look} {snapshot.not_started}"


def _trouble(snapshot: Snapshot | None) -> str:
    return "" if snapshot is None else snapshot.trouble
