"""What a calibration says of force, among the entries of its file (group ``force``, since schema version 2).

What is prepared again from the rest is kept in single precision, templates in steps of 2⁻²², whose last bits would
otherwise be half of the file: forces differ by less than 1e-6 of themselves, and templates that are prepared again on
the same computer are the same to the bit.
A file is read by people's robots, so that everything an index, a division or a square root rests on is looked at
before anything is worked out from it.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.file.content import Reading, Writing
from cbsr_qa.domain import CalibrationError
from cbsr_qa.domain.results import Calibration, ForceModel, Lattice, RelaxationKernel

_WHY_NOT: Final = "force/none"
#: Numbers of a model: their field, their name in the file and their unit. None of them can be negative.
_NUMBERS: Final = (
    ("scatter", "scatter", "1"),
    ("threshold", "threshold", "1"),
    ("misfit", "misfit", "1"),
    ("residue_share", "residue_share", "1"),
    ("residue_stderr", "residue_stderr", "1"),
    ("residue_strength", "residue_strength", "1"),
    ("steady_s", "steady", "s"),
    ("place_scatter_mm", "place_scatter", "mm"),
)
#: Templates have the length one, but for rounding to single precision.
_UNIT: Final = 1e-3
#: Steps of a template, whose length is one, and of its slope with the size of the head. Errors of a template add up
#: to 7e-8 of a strength; those of the slope to four times as much for a head of twice the area.
_TEMPLATE_STEP: Final = 2.0**-22
_SLOPE_STEP: Final = 2.0**-20
#: More than any number of a model is, so that its square is a number, and more than any logarithm in one is.
_LARGEST: Final = 1e12
_LARGEST_LOG: Final = 50.0
#: Nodes along an axis: more than any lattice has, and few enough for their product to be a number.
_MOST_NODES: Final = 10_000


def write_force(out: Writing, model: ForceModel | None, no_force: str) -> None:
    """Keep a force model, or why there is none; nothing where neither is known, as before there were any."""
    if model is None and not no_force:
        return
    out.text(_WHY_NOT, no_force)
    if model is None:
        return
    lattice = model.lattice
    out.numbers("force/lattice/origin", (lattice.x_mm, lattice.y_mm), "mm")
    out.number("force/lattice/spacing", lattice.spacing_mm, "mm")
    out.integers("force/lattice/columns", lattice.columns, "1")
    out.integers("force/lattice/rows", lattice.rows, "1")
    out.integers("force/node", model.node)
    out.numbers("force/merging", model.merging, "1/V")
    out.singles("force/templates", model.templates)
    out.singles("force/size_slope", model.size_slope)
    out.singles("force/log_size", model.log_size)
    out.singles("force/log_size_gradient", model.slopes[:, :2], "1/mm")
    out.singles("force/turning", model.slopes[:, 2:], "1/mm^2")
    out.flags("force/fits", model.fits)
    out.numbers("force/log_response", model.log_response)
    out.numbers("force/log_response_stderr", model.log_response_stderr)
    out.numbers("force/stress", model.stress_kPa, "kPa")
    for field, name, units in _NUMBERS:
        out.number(f"force/{name}", getattr(model, field), units)
    for name, kernel in (("loading", model.loading), ("unloading", model.unloading)):
        if kernel is not None:
            _write_kernel(out, f"force/{name}", kernel)


def _write_kernel(out: Writing, at: str, kernel: RelaxationKernel) -> None:
    out.numbers(f"{at}/weights", kernel.weights)
    out.numbers(f"{at}/time_constants", kernel.time_constants_s, "s")
    out.numbers(f"{at}/covariance", kernel.covariance)
    out.numbers(f"{at}/scatter", kernel.scatter)
    out.number(f"{at}/scatter_freedom", kernel.scatter_freedom)
    out.integers(f"{at}/loads", kernel.loads, "1")
    out.number(f"{at}/start", kernel.start_s, "s")
    out.text(f"{at}/why", kernel.why)


def read_force(read: Reading) -> tuple[ForceModel | None, str]:
    """Return the force model, or None and why there is none (empty in files of before there were any).

    Raises
    ------
    CalibrationError
        If an entry is missing, has another shape than its neighbours, or holds what cannot be worked with.
    """
    if not read.groups("force") and not read.has(_WHY_NOT):
        return None, ""
    why = read.text(_WHY_NOT)
    if why:
        return None, why
    model = _model(read)
    for problem in _problems(model):
        raise CalibrationError(problem)
    return model, ""


def as_filed(model: ForceModel) -> ForceModel:
    """Return a model with the precision its file has, so that what is issued is what is read."""
    return replace(
        model,
        templates=_single(_in_steps(model.templates, _TEMPLATE_STEP)),
        size_slope=_single(_in_steps(model.size_slope, _SLOPE_STEP)),
        log_size=_single(model.log_size),
        slopes=_single(model.slopes),
        merging=model.merging + 0.0,
        log_response=model.log_response + 0.0,
        log_response_stderr=model.log_response_stderr + 0.0,
    )


def check_usable(calibration: Calibration) -> None:
    """Make sure that what a force model leans on can be worked with.

    Raises
    ------
    CalibrationError
        If merging, reference and used readings do not fit each other, or a slope, current or head is no number that
        could be divided by.
    """
    model, used = calibration.force, calibration.reconstruction.problem.used
    if model is None:
        return
    shape = calibration.sensor_type.pattern.shape
    if calibration.reference.shape != shape or used.shape != shape:
        raise CalibrationError(
            f"reference/voltages of {calibration.reference.shape} and reconstruction/used of {used.shape} are not"
            f" those of {shape[0]} drive and {shape[1]} measure pairs"
        )
    if model.merging.shape[1] != int(used.sum()):
        raise CalibrationError(f"force/merging is for {model.merging.shape[1]} readings, {int(used.sum())} are used")
    if not np.isfinite(calibration.reference[used]).all():
        raise CalibrationError("reference/voltages holds a used reading that is not a finite number")
    line, validity = calibration.against_stress, calibration.validity
    known = (line.slope.stderr, line.intercept.stderr, line.covariance, *(validity.force_N or ()))
    finite = (line.slope.value, line.intercept.value, validity.radius_mm, *(x for x in known if x is not None))
    if not np.isfinite(finite).all() or line.slope.value == 0:
        raise CalibrationError("quasi_static/against_stress or validity holds what no force can be worked out from")
    positive = (calibration.current_A, calibration.indenter.diameter_mm, calibration.indenter.squared_radius_mm2)
    if not all(np.isfinite(value) and value > 0 for value in positive):
        raise CalibrationError("reference/current or indenter is not a positive number")


def _in_steps(values: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    return np.round(values / step) * step


def _single(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return (values + 0.0).astype(np.float32).astype(np.float64)


def _model(read: Reading) -> ForceModel:
    origin, stress = read.pair("force/lattice/origin"), read.pair("force/stress")
    if origin is None or stress is None:
        raise CalibrationError("force/lattice/origin or force/stress is empty")
    size = read.integer("force/lattice/columns"), read.integer("force/lattice/rows")
    if not all(2 <= count <= _MOST_NODES for count in size):
        raise CalibrationError(f"force/lattice is of {size[0]} × {size[1]} places; 2 to {_MOST_NODES} are allowed")
    gradient, turning = read.singles("force/log_size_gradient"), read.singles("force/turning")
    if gradient.shape != (len(gradient), 2) or turning.shape != (len(gradient), 3):
        raise CalibrationError(
            f"force/log_size_gradient {gradient.shape} and force/turning {turning.shape} do not fit"
        )
    return ForceModel(
        lattice=Lattice(*origin, read.number("force/lattice/spacing"), *size),
        node=read.integers("force/node"),
        merging=read.numbers("force/merging"),
        templates=read.singles("force/templates"),
        log_size=read.singles("force/log_size"),
        size_slope=read.singles("force/size_slope"),
        slopes=np.hstack([gradient, turning]),
        fits=read.flags("force/fits"),
        log_response=read.numbers("force/log_response"),
        log_response_stderr=read.numbers("force/log_response_stderr"),
        stress_kPa=stress,
        loading=_kernel(read, "loading"),
        unloading=_kernel(read, "unloading"),
        **{field: read.number(f"force/{name}") for field, name, _ in _NUMBERS},
    )


def _kernel(read: Reading, name: str) -> RelaxationKernel | None:
    at = f"force/{name}"
    if name not in read.groups("force"):
        return None
    kernel = RelaxationKernel(
        loading=name == "loading",
        weights=read.numbers(f"{at}/weights"),
        time_constants_s=read.numbers(f"{at}/time_constants"),
        covariance=read.numbers(f"{at}/covariance"),
        scatter=read.numbers(f"{at}/scatter"),
        scatter_freedom=read.number(f"{at}/scatter_freedom"),
        loads=read.integer(f"{at}/loads"),
        start_s=read.number(f"{at}/start"),
        why=read.text(f"{at}/why"),
    )
    count, tau = len(kernel.weights), kernel.time_constants_s
    shapes = kernel.weights.shape, tau.shape, kernel.scatter.shape, kernel.covariance.shape
    if shapes != ((count,), (count,), (count,), (2 * count, 2 * count)):
        raise CalibrationError(f"{at}: weights, time constants, scatter and covariance have the shapes {shapes}")
    if (
        not (tau > 0).all()
        or (np.diff(tau) <= 0).any()
        or not kernel.scatter_freedom > 0
        or (kernel.scatter < 0).any()
    ):
        raise CalibrationError(f"{at} holds time constants that are not positive and rising, or no freedom")
    numbers = np.concatenate([kernel.weights, tau, kernel.scatter, kernel.covariance.ravel(), [kernel.start_s]])
    if not np.isfinite(numbers).all():
        raise CalibrationError(f"{at} holds what is not a finite number")
    return kernel


def _problems(model: ForceModel) -> Iterator[str]:
    """What is wrong with a model; shapes first, since the rest rests on them."""
    yield from _shapes(model)
    yield from _nodes(model)
    yield from _sizes(model)
    yield from _numbers(model)


def _shapes(model: ForceModel) -> Iterator[str]:
    if model.node.shape != (model.lattice.rows, model.lattice.columns):
        yield f"force/node of {model.node.shape} is not {model.lattice.rows} rows of {model.lattice.columns} columns"
    if model.templates.ndim != 2 or not model.templates.size:
        yield f"force/templates has the shape {model.templates.shape}"
        return
    nodes, rows = model.templates.shape
    expected = {
        "size_slope": (nodes, rows),
        "log_size": (nodes,),
        "slopes": (nodes, 5),
        "fits": (nodes,),
        "log_response": (nodes,),
        "log_response_stderr": (nodes,),
    }
    for name, shape in expected.items():
        found = getattr(model, name).shape
        if found != shape:
            called = "log_size_gradient" if name == "slopes" else name
            yield f"force/{called} of {found} does not fit {nodes} templates of {rows} rows"
    if model.merging.ndim != 2 or len(model.merging) != rows:
        yield f"force/merging of {model.merging.shape} does not make the {rows} rows of a template"


def _nodes(model: ForceModel) -> Iterator[str]:
    there = model.node[model.node >= 0]
    if (model.node < -1).any() or not np.array_equal(np.sort(there), np.arange(len(model.templates))):
        yield f"force/node does not name each of {len(model.templates)} templates once, and −1 elsewhere"
    if not model.fits.any():
        yield "force/fits allows a head nowhere"


def _sizes(model: ForceModel) -> Iterator[str]:
    """Numbers that are none, or so large that nothing could be worked out from them."""
    lattice = model.lattice
    arrays = {
        "lattice": np.array([lattice.x_mm, lattice.y_mm, lattice.spacing_mm]),
        "merging": model.merging,
        "templates": model.templates,
        "size_slope": model.size_slope,
        "log_size": model.log_size,
        "log_size_gradient or turning": model.slopes,
        "log_response": model.log_response,
        "log_response_stderr": model.log_response_stderr,
        "stress": np.array(model.stress_kPa),
        **{name: np.array([getattr(model, field)]) for field, name, _ in _NUMBERS},
    }
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            yield f"force/{name} holds what is not a finite number"
        elif (np.abs(values) > _LARGEST).any():
            yield f"force/{name} holds {np.abs(values).max():.3g}, which is no sensor's; {_LARGEST:g} is allowed"
    for name in ("log_size", "log_response", "log_response_stderr"):
        if (np.abs(arrays[name]) > _LARGEST_LOG).any():
            yield f"force/{name} holds {np.abs(arrays[name]).max():.3g}; {_LARGEST_LOG:g} is allowed of a logarithm"


def _numbers(model: ForceModel) -> Iterator[str]:
    xx, xy, yy = model.slopes[:, 2:].T
    if not ((xx > 0) & (xx * yy - xy**2 > 0)).all():
        yield "force/turning is not positive definite somewhere: no place could be found there"
    if not model.lattice.spacing_mm > 0:
        yield f"force/lattice/spacing of {model.lattice.spacing_mm:g} mm is not positive"
    if not np.allclose(np.linalg.norm(model.templates, axis=1), 1, rtol=0, atol=_UNIT):
        yield "force/templates are not of the length one"
    if (model.log_response_stderr < 0).any():
        yield "force/log_response_stderr is negative somewhere"
    for field, name, _ in _NUMBERS:
        if getattr(model, field) < 0:
            yield f"force/{name} is negative"
    if not (model.threshold > 0 and model.misfit > 0 and 0 <= model.stress_kPa[0] <= model.stress_kPa[1]):
        yield "force/threshold, force/misfit or force/stress is out of range"
