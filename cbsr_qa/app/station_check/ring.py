"""The reference ring in place of the sheet: in simulated worlds, and in words for the operator."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from cbsr_qa.config.merging import Configuration
from cbsr_qa.domain.plan.plan import InstrumentSpec, Station
from cbsr_qa.station.bench import FRAME_SOURCE


def simulates_frames(station: Station) -> bool:
    """Whether the frames of a station are simulated, so that a ring can replace the sheet."""
    sources = [spec for spec in station.instruments if FRAME_SOURCE in spec.provides]
    return station.emulated_scene is not None or any("scene" in spec.options for spec in sources)


def with_ring(configuration: Configuration, resistances_ohm: tuple[float, ...]) -> Configuration:
    """Connect a ring in place of the sheet in every world the station simulates."""
    station = configuration.station

    def replace_scene(spec: InstrumentSpec) -> InstrumentSpec:
        if FRAME_SOURCE not in spec.provides or "scene" not in spec.options:
            return spec
        return replace(spec, options={**spec.options, "scene": _add_ring(spec.options["scene"], resistances_ohm)})

    emulated_scene = station.emulated_scene
    if isinstance(emulated_scene, Mapping):
        emulated_scene = _add_ring(emulated_scene, resistances_ohm)
    instruments = tuple(replace_scene(spec) for spec in station.instruments)
    return replace(configuration, station=replace(station, instruments=instruments, emulated_scene=emulated_scene))


def _add_ring(scene: Mapping[str, Any], resistances_ohm: tuple[float, ...]) -> dict[str, Any]:
    return {**scene, "scene": {**scene["scene"], "reference_ring_ohm": list(resistances_ohm)}}


def describe_connecting(resistances_ohm: tuple[float, ...]) -> str:
    """Ask for a ring of (n,) resistances."""
    alike = len(set(resistances_ohm)) == 1
    resistance_words = (
        f"{resistances_ohm[0]:g} Ω each" if alike else f"{min(resistances_ohm):g} to {max(resistances_ohm):g} Ω"
    )
    return f"Connect the reference ring ({len(resistances_ohm)} resistors, {resistance_words}) in place of the sensor"
