"""The sensor, the head and the settings of analysis of the sample run."""

from cbsr_qa.domain.imaging import OverlapBand
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Material, Parameter, QuasiStatic, Relaxation, Response, SensorType

MASKS = (0.25, 0.5, 0.75, 0.85)
BANDS = (OverlapBand("likely poor", 0, 50), OverlapBand("ok", 50, 70), OverlapBand("good", 70, 100))
SETTINGS = AnalysisSettings(
    masks=MASKS,
    main_mask=0.85,
    noise_floor_frames=8,
    reference="run",
    reference_frames=4,
    steady_frames=8,
    settling_multiple=1.5,
    settling_tolerance=0.15,
    settling_band="steady",
    r_squared_gate=0.85,
    overlap_bands=BANDS,
    size_ratio=(1 / 3, 3.0),
    clipping="exact",
    perimeter="length",
    outline="elements",
)
SENSOR = SensorType(
    name="disc-100mm",
    radius_mm=50.0,
    thickness_mm=4.0,
    electrodes=ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 90.0, False),
    pattern=adjacent_pattern(16),
    response=Response.AUTO,
)
INDENTER = Indenter(13.0)
FLOOR = 0.003


def _parameter(value, stderr=None, source="a test"):
    return Parameter(value, stderr, source)


def sample_material():
    fit = QuasiStatic(_parameter(0.0045, 0.0003), _parameter(0.001, 0.002))
    slow = Relaxation((0.2, 0.1), (3.0, 20.0), "a test")
    return Material(
        name="cbsr-8wt",
        interelectrode_resistance_ohm=_parameter(18.1e3, 9.8e3),
        modulus_kPa=_parameter(132.5),
        against_stress=fit,
        against_strain=QuasiStatic(_parameter(0.6, 0.05), _parameter(0.0, 0.01)),
        stress_relaxation=slow,
        loading_relaxation=slow,
        unloading_relaxation=slow,
        relative_noise=_parameter(1e-4),
    )
