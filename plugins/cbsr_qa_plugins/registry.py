"""What this distribution adds. Modules are imported when their name is used, not here."""

from typing import Final

from cbsr_qa.hookspecs import Kind, Register, hookimpl

_HERE: Final = "cbsr_qa_plugins"

#: (kind, name, module and factory below this package)
BUILT_IN: Final[tuple[tuple[Kind, str, str], ...]] = (
    (Kind.INSTRUMENT, "simulated-bench", "hardware.simulated_bench:open_bench"),
    (Kind.SEQUENCE, "noise-figure", "sequences.noise_figure:NoiseFigureSequence"),
    (Kind.SEQUENCE, "location-grid", "sequences.location_grid:LocationGridSequence"),
    (Kind.SEQUENCE, "random-loads", "sequences.random_loads:RandomLoadsSequence"),
    (Kind.SEQUENCE, "relaxation", "sequences.relaxation:RelaxationSequence"),
    (Kind.RECONSTRUCTION, "gauss-newton-noser", "reconstruction.gauss_newton_noser:GaussNewtonNoser"),
    (Kind.RECONSTRUCTION, "gauss-newton-tikhonov", "reconstruction.gauss_newton_tikhonov:GaussNewtonTikhonov"),
    (Kind.RECONSTRUCTION, "gauss-newton-laplace", "reconstruction.gauss_newton_laplace:GaussNewtonLaplace"),
    (Kind.RECONSTRUCTION, "gauss-newton-high-pass", "reconstruction.gauss_newton_high_pass:GaussNewtonHighPass"),
    (Kind.RECONSTRUCTION, "gauss-newton-indenter", "reconstruction.gauss_newton_indenter:GaussNewtonIndenter"),
    (Kind.RECONSTRUCTION, "greit", "reconstruction.greit:Greit"),
    (Kind.RECONSTRUCTION, "truncated-svd", "reconstruction.truncated_svd:TruncatedSvd"),
    (Kind.RECONSTRUCTION, "linear-back-projection", "reconstruction.linear_back_projection:LinearBackProjection"),
    (Kind.RECONSTRUCTION, "total-variation", "reconstruction.total_variation:TotalVariation"),
    (Kind.RECONSTRUCTION, "temporal", "reconstruction.temporal:Temporal"),
    (Kind.RECONSTRUCTION, "absolute-gauss-newton", "reconstruction.absolute_gauss_newton:AbsoluteGaussNewton"),
    (Kind.RECONSTRUCTION, "pyeit-jac", "reconstruction.pyeit_jac:PyeitJac"),
    (Kind.RECONSTRUCTION, "pyeit-greit", "reconstruction.pyeit_greit:PyeitGreit"),
    (Kind.METRIC, "centre-of-mass-error", "metrics.centre_of_mass_error:CentreOfMassError"),
    (Kind.METRIC, "area-overlap", "metrics.area_overlap:AreaOverlap"),
    (Kind.METRIC, "shape-deviation", "metrics.shape_deviation:ShapeDeviation"),
    (Kind.METRIC, "greit-figures", "metrics.greit_figures:GreitFiguresOfMerit"),
    (Kind.METRIC, "load-assignment", "metrics.load_assignment:LoadAssignment"),
    (Kind.METRIC, "two-touch-resolution", "metrics.two_touch_resolution:TwoTouchResolution"),
    (Kind.METRIC, "size-response", "metrics.size_response:SizeResponseMetric"),
    (Kind.METRIC, "load-estimate", "metrics.load_estimate:LoadEstimates"),
    (Kind.METRIC, "noise-figure", "metrics.noise_figure:NoiseFigure"),
    (Kind.METRIC, "image-noise", "metrics.image_noise:ImageNoise"),
    (Kind.METRIC, "channel-noise", "metrics.channel_noise:ChannelNoise"),
    (Kind.METRIC, "reciprocity", "metrics.reciprocity:ReciprocityError"),
    (Kind.METRIC, "contact-resistance", "metrics.contact_resistance:ContactResistance"),
    (Kind.METRIC, "settling-time", "metrics.settling_time:SettlingTimes"),
    (Kind.METRIC, "applied-force", "metrics.applied_force:AppliedForce"),
    (Kind.EFFECT, "sheet-seat", "effects.sheet_seat:SheetSeat"),
    (Kind.EFFECT, "piezoresistivity", "effects.piezoresistivity:Piezoresistivity"),
    (Kind.EFFECT, "conductance-relaxation", "effects.conductance_relaxation:ConductanceRelaxation"),
    (Kind.EFFECT, "elastic-stress", "effects.elastic_stress:ElasticStress"),
    (Kind.EFFECT, "stress-relaxation", "effects.stress_relaxation:StressRelaxation"),
    (Kind.EFFECT, "measurement-noise", "effects.measurement_noise:MeasurementNoise"),
    (Kind.EFFECT, "load-cell-noise", "effects.load_cell_noise:LoadCellNoise"),
    (Kind.RECORDING, "cbsr-recording", "recordings.cbsr_recording:CbsrRecording"),
    (Kind.RECORDING, "ert-board-csv", "recordings.ert_board_csv:ErtBoardCsv"),
    (Kind.RECORDING, "smu-rig-csv", "recordings.smu_rig_csv:SmuRigCsv"),
    (Kind.RECORDING, "eidors-mat", "recordings.eidors_mat:EidorsMat"),
    (Kind.RECORDING, "ds-tank-text", "recordings.ds_tank_text:DsTankText"),
    (Kind.SECTION, "nine-locations", "sections.nine_locations:NineLocations"),
    (Kind.SECTION, "load-estimates", "sections.load_estimates:LoadEstimates"),
    (Kind.SECTION, "load-images", "sections.load_images:LoadImages"),
    (Kind.SECTION, "mask-comparison", "sections.mask_comparison:MaskComparison"),
    (Kind.SECTION, "image-quality", "sections.image_quality:ImageQuality"),
    (Kind.SECTION, "size-response", "sections.size_response:SizeResponses"),
    (Kind.SECTION, "regularisation", "sections.regularisation:RegularisationParameter"),
    (Kind.SECTION, "random-loads", "sections.random_loads:RandomLoads"),
    (Kind.SECTION, "relaxation", "sections.relaxation:RelaxationFits"),
    (Kind.SECTION, "baseline-conductance", "sections.baseline_conductance:BaselineConductanceMap"),
    (Kind.SECTION, "noise-and-contacts", "sections.noise_and_contacts:NoiseAndContacts"),
    (Kind.SECTION, "time-and-accuracy", "sections.time_and_accuracy:TimeAndAccuracy"),
    (Kind.SECTION, "limits", "sections.limits:Limits"),
    (Kind.SECTION, "traceability", "sections.traceability:Traceability"),
    (Kind.SECTION, "recording-events", "sections.recording_events:RecordingEvents"),
    (Kind.SECTION, "recording-channels", "sections.recording_channels:RecordingChannels"),
    (Kind.SECTION, "recording-rows", "sections.recording_rows:RecordingRows"),
)


@hookimpl
def cbsr_register(register: Register) -> None:
    """Register every built-in."""
    for kind, name, target in BUILT_IN:
        register(kind, name, f"{_HERE}.{target}")
