"""A small observed run made by hand, for tests of metrics and of issuing."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
from calibration_samples import sample_reconstruction, sample_sensor_type

from cbsr_qa.domain.imaging import Blob, Image, OverlapBand
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import FrameBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Indenter, Load, LoadRecord
from cbsr_qa.domain.results.observation import LoadObservation, MaskView, RelaxationObservation, RunObservation, Trace
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, SettlingTime
from cbsr_qa.domain.run.run import PhaseRecord, RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import Material, Parameter, QuasiStatic, Relaxation, Response, SensorIdentity

INDENTER = Indenter(13.0)
SETTINGS = AnalysisSettings(
    masks=(0.25, 0.85),
    main_mask=0.85,
    noise_floor_frames=8,
    reference="run",
    reference_frames=4,
    steady_frames=4,
    settling_multiple=1.5,
    settling_tolerance=0.15,
    settling_band="steady",
    r_squared_gate=0.85,
    overlap_bands=(OverlapBand("likely poor", 0, 50), OverlapBand("ok", 50, 70), OverlapBand("good", 70, 100)),
    size_ratio=(1 / 3, 3.0),
    clipping="exact",
    perimeter="length",
    outline="elements",
)


def sample_material(slope_per_kPa: float = 4.5e-3, slope_stderr: float | None = None) -> Material:
    def known(value: float) -> Parameter:
        return Parameter(value, None, "chosen by us: a test")

    relaxation = Relaxation((-0.2, -0.55), (2.5, 23.1), "chosen by us: a test")
    return Material(
        name="test",
        interelectrode_resistance_ohm=known(18100.0),
        modulus_kPa=known(132.5),
        against_stress=QuasiStatic(Parameter(slope_per_kPa, slope_stderr, "a test"), known(0.0)),
        against_strain=QuasiStatic(known(0.6), known(0.0)),
        stress_relaxation=relaxation,
        loading_relaxation=relaxation,
        unloading_relaxation=relaxation,
        relative_noise=known(7e-4),
    )


def indenter_mesh(x_mm: float, y_mm: float, radius_mm: float, spokes: int = 180) -> Mesh:
    """A fan of triangles over a disc: its blob is the disc."""
    angle = 2 * np.pi * np.arange(spokes) / spokes
    rim = np.column_stack([x_mm + radius_mm * np.cos(angle), y_mm + radius_mm * np.sin(angle)])
    here = np.arange(spokes)
    elements = np.column_stack([np.zeros(spokes, dtype=int), 1 + here, 1 + (here + 1) % spokes])
    return Mesh(np.vstack([[x_mm, y_mm], rim]), elements)


def sample_load(
    label: str = "L0",
    place_mm: tuple[float, float] = (0.0, 0.0),
    *,
    blob_mm: tuple[float, float, float] | None = (0.0, 0.0, 6.5),
    change: float = 0.03,
    force_N: float | None = 3.0,
    trial: int = 0,
    phase: str = "nine locations",
    index: int = 0,
    response: Response = Response.INCREASE,
) -> LoadObservation:
    """A press whose image is a uniform disc (x, y, radius), or without any blob."""
    mesh = indenter_mesh(*(blob_mm or (0.0, 0.0, 6.5)))
    sign = -1.0 if response is Response.DECREASE else 1.0
    image = Image(mesh, np.full(len(mesh.elements), sign * change))
    cleared = Image(mesh, np.full(len(mesh.elements), change - 0.005))
    blobs = () if blob_mm is None else (Blob(cleared, np.arange(len(mesh.elements))),)
    masks = tuple(
        MaskView(fraction, blobs, blobs[0] if blobs else None, regions=len(blobs)) for fraction in SETTINGS.masks
    )
    return LoadObservation(
        phase=phase,
        record=LoadRecord(index, Load(label, *place_mm, 0.2, trial), 100.0, 101.0, 161.0, 162.0, 222.0),
        indenter=INDENTER,
        image=image,
        response=response,
        noise_floor=0.005,
        masks=masks,
        steady_frames=4,
        settled=True,
        force_N=force_N,
        force_stderr_N=None if force_N is None else 0.01,
    )


def sample_relaxation(
    value_s: float | None, *, censored: bool = False, signal: str = "conductance", loading: bool = True
) -> RelaxationObservation:
    status = FitStatus.REJECTED if value_s is None else FitStatus.ONE
    fit = RelaxationFit(status, 1.0, (-0.5,), (10.0,), 0.01, (0.5,), 0.97, "R² 0.2 is below 0.85")
    why = {True: "not settled within 60 s", False: ""}[censored] or ("rejected: R² 0.2" if value_s is None else "")
    trace = Trace("blob", "1", np.arange(24.0), np.ones(24))
    return RelaxationObservation(signal, loading, trace, fit, SettlingTime(value_s, censored, 0.15, why))


def sample_run(
    loads: tuple[LoadObservation, ...] = (),
    *,
    unloaded: np.ndarray | None = None,
    noise: float = 1e-3,
    frames: int = 30,
    current_A: float | None = 1e-3,
    unit: VoltageUnit = VoltageUnit.VOLT,
    material: Material | None = None,
    pressed: FrameBlock | None = None,
    seed: int = 3,
) -> RunObservation:
    """A run on six electrodes whose reference is ten times the unit model's frame (reciprocal), plus noise."""
    sensor_type = sample_sensor_type()
    reconstruction = sample_reconstruction(sensor_type)
    random = np.random.default_rng(seed)
    half = random.uniform(0.5, 1.5, sensor_type.pattern.shape)
    clean = 10 * (half + half.T)
    reconstruction = replace(
        reconstruction, problem=replace(reconstruction.problem, reference=clean[reconstruction.problem.used] / 10)
    )
    voltages = clean + noise * random.standard_normal((frames, *clean.shape)) if unloaded is None else unloaded
    block = FrameBlock(2.5 * np.arange(len(voltages)), voltages, np.zeros(voltages.shape, np.uint8), unit, current_A)
    names = dict.fromkeys(load.phase for load in loads)
    phases = tuple(
        PhaseRecord(i, name, "any", 0.0, 500.0, pressed, role=Role.NOISE if "noise" in name else Role.GRID)
        for i, name in enumerate(names)
    )
    identity = RunIdentity(
        run="0193-run",
        sensor=SensorIdentity("S-1", "41", sensor_type.name),
        station="test",
        recipe="test",
        operator="",
        started_at=datetime(2026, 1, 1, tzinfo=UTC),
        configuration_digest="0" * 64,
        software=(),
        instruments=(),
        simulated=("everything",),
    )
    record = RunRecord(
        identity, sensor_type, material or sample_material(), INDENTER, phases, EndReason.FINISHED, "", 600.0
    )
    return RunObservation(
        record=record,
        reconstruction=reconstruction,
        scale=10.0,
        unloaded=block,
        reference=clean,
        noise_floor=0.005,
        noise_images=noise * random.standard_normal((8, len(loads[0].image.values) if loads else 4)),
        response=Response.INCREASE,
        response_how="configured",
        main_mask=0.85,
        loads=loads,
        usable=reconstruction.problem.used,
        settings=SETTINGS,
    )
