"""SVG in a page: nothing in it does more than be looked at, and its names are its own. Without matplotlib."""

import hashlib
import re
from typing import Final
from xml.etree import ElementTree

from cbsr_qa.domain.errors import RefusedError

_NAMESPACE: Final = "{http://www.w3.org/2000/svg}"
_HREFS: Final = ("href", "{http://www.w3.org/1999/xlink}href")
_SHAPES: Final = frozenset(
    {"path", "rect", "circle", "ellipse", "line", "polyline", "polygon", "image", "text", "tspan"}
)
_DRAWN: Final = _SHAPES | {
    *("svg", "g", "defs", "use", "symbol", "title", "desc", "clipPath", "mask", "pattern", "marker"),
    *("linearGradient", "radialGradient", "stop"),
}
_BITMAP: Final = re.compile(r"data:image/(png|jpeg);base64,[A-Za-z0-9+/=\s]*\Z")
_OWN_URL: Final = re.compile(r"url\(\s*(?!['\"]?#)", re.IGNORECASE)


def check_svg(svg: str) -> str:
    """Return an SVG without active content.

    Raises
    ------
    RefusedError
        If it is not well-formed, or holds anything but drawing, or refers to anything outside itself.
    """
    if "<!" in svg or "<?" in svg:
        raise RefusedError("a figure holds a comment or a declaration; an inline SVG needs neither")
    try:
        root = ElementTree.fromstring(svg)  # no declarations, hence no entities to expand
    except ElementTree.ParseError as error:
        raise RefusedError(f"a figure is not a well-formed SVG: {error}") from error
    if root.tag != f"{_NAMESPACE}svg":
        raise RefusedError(f"a figure is not an SVG but {root.tag!r}")
    for element in root.iter():
        _check_element(element)
    return svg


def _check_element(element: ElementTree.Element) -> None:
    name = element.tag.removeprefix(_NAMESPACE)
    if name not in _DRAWN:
        raise RefusedError(f"a figure holds <{name}>, which is not a drawing")
    for key, value in element.attrib.items():
        if key.rpartition("}")[2].lower().startswith("on"):
            raise RefusedError(f"a figure holds the event handler {key!r}")
        if _OWN_URL.search(value):
            raise RefusedError(f"a figure refers to something outside itself: {key}={value[:60]!r}")
        if key in _HREFS and not (value.startswith("#") or (name == "image" and _BITMAP.match(value))):
            raise RefusedError(f"a figure refers to something outside itself: {key}={value[:60]!r}")


def strip_document(document: str) -> str:
    """Strip what only a separate file needs: declarations, metadata, comments, the style sheet for ``*``."""
    body = document[document.index("<svg") :]
    body = re.sub(r"<!--.*?-->\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"<defs>\s*<style[^>]*>.*?</style>\s*</defs>\s*", "", body, count=1, flags=re.DOTALL)
    return body.replace("<svg ", '<svg stroke-linejoin="round" stroke-linecap="butt" ', 1).strip()


def rename_own(body: str) -> str:
    """Keep only names that are referred to, and make them this figure's own: a page holds many figures."""
    used_ids = set(re.findall(r'(?:href="|url\()#([^")]+)', body))
    mark = hashlib.sha256(body.encode()).hexdigest()[:8]

    def rename(match: re.Match[str]) -> str:
        name = match.group(1)
        return f' id="f{mark}-{name}"' if name in used_ids else ""

    body = re.sub(r'\sid="([^"]*)"', rename, body)
    return re.sub(r'(href="|url\()#', rf"\g<1>#f{mark}-", body)
