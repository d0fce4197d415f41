"""Material files as they are written: what :mod:`cbsr_qa.config.material_file` reads, with every source."""

import json
from collections.abc import Iterator, Sequence

from cbsr_qa.domain.sensor import Material, MeasuredKernel, Parameter, QuasiStatic, Relaxation, StripRelaxation


def material_text(material: Material, comments: Sequence[str] = ()) -> str:
    """Write a material as TOML.

    Parameters
    ----------
    comments : lines before everything else.

    Returns
    -------
    The file's content; numbers come back as they were.
    """
    return "\n".join([*(f"# {line}".rstrip() for line in comments), *_lines(material)]) + "\n"


def _lines(material: Material) -> Iterator[str]:
    yield from ("", "[material]", f"name = {_text(material.name)}")
    yield from _parameter("interelectrode_resistance_ohm", material.interelectrode_resistance_ohm)
    yield from _parameter("modulus_kPa", material.modulus_kPa)
    yield from _parameter("relative_noise", material.relative_noise)
    yield from _quasi_static("against_stress", "slope_per_kPa", material.against_stress)
    yield from _quasi_static("against_strain", "slope", material.against_strain)
    yield from _relaxation("stress_relaxation", material.stress_relaxation)
    yield from _relaxation("loading_relaxation", material.loading_relaxation)
    yield from _relaxation("unloading_relaxation", material.unloading_relaxation)
    if material.strip_relaxation is not None:
        yield from _strip(material.strip_relaxation)


def _parameter(name: str, parameter: Parameter) -> Iterator[str]:
    yield from ("", f"[material.{name}]", f"value = {_number(parameter.value)}")
    if parameter.stderr is not None:
        yield f"stderr = {_number(parameter.stderr)}"
    yield f"source = {_text(parameter.source)}"


def _quasi_static(name: str, slope: str, line: QuasiStatic) -> Iterator[str]:
    if line.covariance is not None:
        yield from ("", f"[material.{name}]", f"covariance = {_number(line.covariance)}")
    yield from _parameter(f"{name}.{slope}", line.slope)
    yield from _parameter(f"{name}.intercept", line.intercept)


def _relaxation(name: str, kernel: Relaxation) -> Iterator[str]:
    yield from ("", f"[material.{name}]")
    yield f"weights = {_numbers(kernel.weights)}"
    yield f"time_constants_s = {_numbers(kernel.time_constants_s)}"
    yield f"source = {_text(kernel.source)}"


def _strip(strip: StripRelaxation) -> Iterator[str]:
    yield from ("", "[material.strip_relaxation]", f"cycles = {strip.cycles}")
    yield f"least_strain = {_number(strip.least_strain)}"
    yield f"largest_strain = {_number(strip.largest_strain)}"
    yield f"source = {_text(strip.source)}"
    for name, kernel in (("loading", strip.loading), ("unloading", strip.unloading)):
        if kernel is not None:
            yield from _measured(f"strip_relaxation.{name}", kernel)


def _measured(name: str, kernel: MeasuredKernel) -> Iterator[str]:
    yield from ("", f"[material.{name}]", f"weights = {_numbers(kernel.weights)}")
    yield f"time_constants_s = {_numbers(kernel.time_constants_s)}"
    yield f"covariance = [{', '.join(_numbers(row) for row in kernel.covariance)}]"
    yield f"start_s = {_number(kernel.start_s)}"
    yield f"window_s = {_number(kernel.window_s)}"


def _numbers(values: Sequence[float]) -> str:
    return f"[{', '.join(map(_number, values))}]"


def _number(value: float) -> str:
    return repr(float(value))


def _text(value: str) -> str:
    """Quote text: TOML's basic strings are JSON's, but for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
