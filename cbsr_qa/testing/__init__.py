"""Kit for plugin authors: conformance checks, and assertions about numerical methods."""

from cbsr_qa.testing.bench import (
    FixedSequence as FixedSequence,
    Script as Script,
    ScriptedApplicator as ScriptedApplicator,
    ScriptedFrames as ScriptedFrames,
    ScriptedInstrument as ScriptedInstrument,
    ScriptedLoadCell as ScriptedLoadCell,
    example_identity as example_identity,
    example_plan as example_plan,
    make_scripted_bench as make_scripted_bench,
    raising as raising,
)
from cbsr_qa.testing.checked import Tolerances as Tolerances
from cbsr_qa.testing.instruments import (
    check_applicator as check_applicator,
    check_closing as check_closing,
    check_frame_source as check_frame_source,
    check_sampler as check_sampler,
)
from cbsr_qa.testing.kit.conformance import assert_conforms as assert_conforms
from cbsr_qa.testing.numerics import (
    assert_adjoint as assert_adjoint,
    assert_expected_order as assert_expected_order,
    check_metric as check_metric,
    convergence_order as convergence_order,
)
from cbsr_qa.testing.reconstructions import (
    check_reconstruction as check_reconstruction,
    compare_elsewhere as compare_elsewhere,
    elsewhere_readings as elsewhere_readings,
)
from cbsr_qa.testing.replaying import (
    assert_replays as assert_replays,
    replay_pairs as replay_pairs,
    replay_transcript as replay_transcript,
)
from cbsr_qa.testing.scanning import (
    check_multiplexer as check_multiplexer,
    check_self_test as check_self_test,
    check_source_meter as check_source_meter,
)
from cbsr_qa.testing.sinks import check_sink as check_sink, example_messages as example_messages
from cbsr_qa.testing.targets import example_problem as example_problem, images_elsewhere as images_elsewhere
