"""A small calibration that uses every field, for tests of what is done with one."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, OverlapBand, ParameterChoice
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import (
    BaselineConductance,
    Calibration,
    ForceModel,
    Lattice,
    LoadRelaxation,
    SettlingSummary,
    Validity,
)
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, RelaxationKernel, SettlingTime
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Response, SensorIdentity, SensorType

LOAD_CELL = ReferenceStandard("load_cell", "K-2026-0711", "D-K-15000", "2026-03-02", "2027-03-31", 0.5, 2.0, "%")
INDENTER = ReferenceStandard("indenter", "L-99", "D-K-15001", "2025-05-05", "2030-05-05", 0.02, 2.0, "mm")


def sample_sensor_type(electrodes: int = 6) -> SensorType:
    return SensorType(
        name="disc-test",
        radius_mm=50.0,
        thickness_mm=4.0,
        electrodes=ElectrodeLayout(electrodes, ElectrodeKind.PIN, 48.0, 0.65, 12.5, False),
        pattern=adjacent_pattern(electrodes),
        response=Response.AUTO,
    )


def sample_reconstruction(sensor_type: SensorType, seed: int = 5) -> LinearReconstruction:
    random = np.random.default_rng(seed)
    used = sensor_type.pattern.usable()
    nodes = np.array([[0.0, 0.0], [20.0, 0.0], [0.0, 20.0], [-20.0, 0.0], [0.0, -20.0]])
    elements = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]])
    mesh = Mesh(nodes, elements, (np.array([[1, 2]]), np.array([[2, 3], [3, 4]])))
    readings = int(used.sum())
    problem = ImagingProblem(
        sensor_type,
        mesh,
        random.standard_normal((readings, 4)),
        random.standard_normal(readings),
        used,
        random.uniform(1, 2, readings),
    )
    matrix = random.standard_normal((4, readings))
    choice = ParameterChoice(0.03, "chosen for a test", 1.02, "μ", criterion="l-curve")
    return LinearReconstruction("test-method", problem, matrix, choice)


def sample_force(readings: int, merged: int = 7, seed: int = 9) -> ForceModel:
    """A force model on a lattice of 8 × 7 places without its corners; its templates turn smoothly with the place."""
    random = np.random.default_rng(seed)
    lattice = Lattice((-35.0, -30.0), 10.0, 8, 7)
    inside = np.ones(56, dtype=bool)
    inside[[0, 7, 48, 55]] = False
    x, y = lattice.places_mm()[inside].T / 35
    waves = random.uniform(-0.4, 0.4, (3, merged))
    templates = np.cos(random.uniform(0, 6, merged) + np.column_stack([x, y, x * y]) @ waves)
    templates /= np.linalg.norm(templates, axis=1)[:, None]

    def single(values: np.ndarray) -> np.ndarray:
        return (values + 0.0).astype(np.float32).astype(np.float64)

    nodes = len(templates)
    kernel = RelaxationKernel(True, np.array([-0.2]), np.array([9.5]), np.eye(2) / 7, np.array([0.01]), 8.0, 9, 1.25)
    return ForceModel(
        lattice=lattice,
        node=np.where(inside, np.cumsum(inside) - 1, -1).reshape(7, 8),
        merging=random.standard_normal((merged, readings)),
        templates=single(templates),
        log_size=single(5 + 0.1 * x),
        size_slope=single(random.standard_normal((nodes, merged)) / 50),
        log_size_gradient=single(np.column_stack([x, y]) / 100),
        turning=single(np.column_stack([1 + x**2, x * y / 9, 1 + y**2]) / 100),
        fits=x**2 + y**2 < 0.9,
        log_response=0.1 * x - 0.05 * y + 0.0,
        log_response_stderr=0.02 + 0.01 * y**2,
        scatter=0.011,
        stress_kPa=(8.25, 41.5),
        threshold=4.96,
        misfit=0.04,
        residue_share=0.3,
        residue_stderr=0.25,
        residue_strength=0.0021,
        steady_s=52.5,
        place_scatter_mm=0.125,
        loading=kernel,
        unloading=replace(kernel, loading=False, start_s=0.0, why="a remark"),
    )


def sample_calibration() -> Calibration:
    sensor_type = sample_sensor_type()
    two = RelaxationFit(FitStatus.TWO, 0.12, (-0.02, -0.05), (2.5, 23.1), 1e-3, (0.2, 1.5), 0.998, "")
    one = RelaxationFit(FitStatus.ONE, 0.2, (-0.1,), (31.0,), 2e-3, (2.5,), 0.97, "no second time constant")
    none = RelaxationFit(FitStatus.REJECTED, 0.1, (), (), 0.01, (), 0.0, "3 points are too few; 5 are needed")
    return Calibration(
        calibration="0193-c",
        run="0193-r",
        issued_at="2026-11-21T08:00:00+13:00",
        sensor=SensorIdentity("S-001 ü", "batch 41", "disc-test"),
        sensor_type=sensor_type,
        indenter=Indenter(13.0),
        reference=np.random.default_rng(1).standard_normal(sensor_type.pattern.shape),
        current_A=0.0009,
        scale=-1.7e-2,
        reconstruction=sample_reconstruction(sensor_type),
        response=Response.DECREASE,
        noise_floor=5.97e-3,
        mask=0.85,
        baseline=(
            BaselineConductance("L0", 0.0, 0.0, 0.31, 0.004, 3),
            BaselineConductance("L1", 30.0, 0.0, None, None, 0, "no blob was sensed"),
        ),
        against_stress=QuasiStatic(
            Parameter(4.53e-3, 2e-4, "paper"), Parameter(-1e-3, None, "chosen by us"), covariance=-1.5e-8
        ),
        against_strain=QuasiStatic(Parameter(0.6, None, "paper"), Parameter(0.0, None, "chosen by us")),
        assumed=("α against stress", "β against stress"),
        settling=(
            SettlingSummary("conductance", True, 29.5, 3.0, 8, 1, 0),
            SettlingSummary("stress", False, None, None, 0, 0, 9),
        ),
        overlap_bands=(OverlapBand("likely poor", 0.0, 50.0), OverlapBand("good", 50.0, 100.0)),
        overlap_threshold=50.0,
        validity=Validity((0.9, 3.5), (0.05, 0.2), None, 30.0, ("L1 is left out",)),
        simulated=("bench",),
        relaxations=(
            LoadRelaxation("L0", 0, "conductance", True, two, SettlingTime(24.0, False, 0.018, ""), "grid", 3, 0.2),
            LoadRelaxation("L0", 1, "stress", False, none, SettlingTime(None, False, 0.0, "rejected"), unit="kPa"),
            LoadRelaxation("L0", 0, "conductance", True, one, SettlingTime(60.0, True, 0.02, ""), "grid", 12, 0.3),
        ),
        size_ratio=(1 / 3, 3.0),
        noise_figure=1.17,
        force=sample_force(int(sensor_type.pattern.usable().sum())),
    )


def sparse_calibration() -> Calibration:
    """The same with everything optional left out."""
    full = sample_calibration()
    problem = full.reconstruction.problem
    bare = replace(problem, mesh=Mesh(problem.mesh.nodes_mm, problem.mesh.elements), noise_variance=None)
    return replace(
        full,
        reconstruction=replace(full.reconstruction, problem=bare),
        assumed=(),
        settling=(),
        simulated=(),
        relaxations=(),
        size_ratio=None,
        noise_figure=None,
        validity=Validity(None, (0.2, 0.2), (21.5, 22.0), 0.0),
        force=None,
        no_force="2 of 9 loads determine the response of the sheet; 3 are needed",
    )


def assert_same(one: Any, other: Any, path: str) -> None:
    """Assert that two nested dataclasses hold the same, bit for bit, naming the field that does not."""
    assert type(one) is type(other), path
    if is_dataclass(one):
        for field in (one for one in fields(one) if one.name != "file"):  # bytes of what was issued here alone
            assert_same(getattr(one, field.name), getattr(other, field.name), f"{path}.{field.name}")
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), path
    elif isinstance(one, tuple):
        assert len(one) == len(other), path
        for index, (left, right) in enumerate(zip(one, other, strict=True)):
            assert_same(left, right, f"{path}[{index}]")
    elif isinstance(one, float):
        assert one.hex() == other.hex(), path
    else:
        assert one == other, path


@contextmanager
def edited(path: Path) -> Iterator[h5py.File]:
    """A file open for changes; it loses the digest of its bytes, as whoever forges one would see to it."""
    with h5py.File(path, "r+") as file:
        yield file
        block = file.userblock_size
    path.write_bytes(path.read_bytes()[block:])


@contextmanager
def forged(path: Path) -> Iterator[h5py.File]:
    """A file open for changes, which then states the digest of its content, as whoever knows how would make it."""
    with edited(path) as file:
        yield file
    digest = plain_digest(path)
    with edited(path) as file:
        file.attrs["digest"] = digest


def plain_digest(path: Path) -> str:
    """The digest as the documentation describes it, with h5py and hashlib alone."""
    with h5py.File(path) as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        digest = hashlib.sha256(f"cbsr-qa calibration\t{file.attrs['schema_version']}\n".encode())
        for name in sorted(names):
            dataset = file[name]
            if h5py.check_string_dtype(dataset.dtype):
                kind, texts = "text", np.atleast_1d(dataset[()])
                data = b"".join(b"%d\n%s" % (len(text), text) for text in texts)
            else:
                kind = dataset.dtype.str[1:]
                data = np.ascontiguousarray(dataset[()]).astype("<" + kind).tobytes()
            shape = "x".join(str(length) for length in dataset.shape)
            digest.update(f"{name}\t{dataset.attrs['units']}\t{kind}\t{shape}\n".encode())
            digest.update(data)
    return digest.hexdigest()
