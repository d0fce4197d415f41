"""Options and measurements of a plugin, read from its code: for ``cbsr-qa plugins show`` and the reference page."""

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.plugin.listed import OptionReference, PluginReference
from cbsr_qa.plugin.options import options_of
from cbsr_qa.plugin.problems import describe_allowed

#: How names of options end → their unit; the first that fits counts.
_UNITS: Final[Mapping[str, str]] = {
    "_mm_s2": "mm/s²",
    "_mm_s": "mm/s",
    "_K_per_h": "K/h",
    "_per_K": "1/K",
    "_per_hour": "1/h",
    "_per_mm": "1/mm",
    "_percent": "%",
    "_ohm": "Ω",
    "_deg": "°",
    "_min": "min",
    "_dB": "dB",
    "_Hz": "Hz",
    "_hz": "Hz",
    "_C": "°C",
    **{f"_{unit}": unit for unit in ("mm", "ms", "s", "mV", "mA", "V", "A", "N", "g", "K", "kPa")},
}


def plugin_reference(plugins: Plugins, kind: Kind, name: str) -> PluginReference:
    """Return options and measurements of a plugin.

    Raises
    ------
    PluginError
        If it is unknown or cannot be loaded.
    """
    factory = plugins.factory(kind, name)
    model = options_of(factory, handed=int(kind in (Kind.EFFECT, Kind.INSTRUMENT)))
    described = dict(_read_descriptions(factory))
    options = []
    for option, field in model.model_fields.items():
        unit = next((unit for ending, unit in _UNITS.items() if option.endswith(ending)), "")
        is_unset = field.is_required() or field.default is None
        default = "" if is_unset else json.dumps(field.default, ensure_ascii=False)
        allowed, description = describe_allowed(field), described.get(option, "")
        options.append(OptionReference(option, unit, allowed, default, field.is_required(), description))
    text = re.sub(r"(?<!\n)\n(?!\n|\s|[-=])", " ", inspect.getdoc(factory) or "")
    measures = getattr(factory, "measures", None) or {}
    return PluginReference(kind, name, text.partition("\n\n")[0], tuple(options), measures)


def _read_descriptions(factory: Any) -> Iterator[tuple[str, str]]:
    """Yield options and their descriptions in docstrings, in the form ``first, second : words``; own ones last."""
    for cls in reversed(getattr(factory, "__mro__", (factory,))):
        text = inspect.cleandoc(vars(cls).get("__doc__") or "")
        for names, words in re.findall(r"^([a-z]\w*(?:, \w+)*) : (.*(?:\n +.*)*)", text, re.M):
            plain = re.sub(r":\w+:`~?([^`]*)`", lambda role: f"`{role[1].rpartition('.')[2]}`", words)
            for name in names.split(", "):
                yield name, " ".join(plain.split())


def reference_page(plugins: Plugins, distribution: str) -> str:
    """Write the reference of a distribution's plugins as Markdown."""
    lines = [
        "# Plugins and their options",
        "",
        "This page lists the options of every built-in plugin. `cbsr-qa plugins show NAME` prints the same for any",
        "plugin that is installed. `choose` and `noise_figure` of reconstructions [are",
        "explained](../explanation/reconstruction.md#choosing-the-parameter-without-truth).",
    ]
    for kind in Kind:
        names = [r.name for r in plugins.registrations(kind) if r.distribution == distribution]
        lines += ["", f"## {kind.capitalize()}s"]
        for name in names:
            lines += ["", *_entry(plugin_reference(plugins, kind, name))]
    return "\n".join(lines) + "\n"


def _entry(plugin: PluginReference) -> Iterator[str]:
    yield f"### `{plugin.name}`"
    yield ""
    yield plugin.summary
    if plugin.measures:
        yield ""
        yield f"Measures {', '.join(f'`{name}` [{unit}]' for name, unit in plugin.measures.items())}."
    if plugin.options:
        yield ""
        yield "| option | unit | default | allowed | meaning |"
        yield "| --- | --- | --- | --- | --- |"
        for option in plugin.options:
            default = "required" if option.required else f"`{option.default}`" if option.default else ""
            cells = (f"`{option.name}`", option.unit, default, option.allowed, option.description)
            yield f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
