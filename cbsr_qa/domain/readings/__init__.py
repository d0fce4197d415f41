"""Data from instruments: frames, samples, recordings and findings in them."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .carry_over import (
        RECIPROCITY_LIMIT as RECIPROCITY_LIMIT,
        CarryOver as CarryOver,
        correct_carry_over as correct_carry_over,
        estimate_carry_over as estimate_carry_over,
        offset_of as offset_of,
        reciprocity_error as reciprocity_error,
        scan_order as scan_order,
    )
    from .findings import (
        ChannelReport as ChannelReport,
        EventImaging as EventImaging,
        ImagedPlace as ImagedPlace,
        LoadEvent as LoadEvent,
        Motion as Motion,
        NoiseReport as NoiseReport,
        NoiseStep as NoiseStep,
        RecordingResult as RecordingResult,
    )
    from .frames import (
        LARGEST_VALUE as LARGEST_VALUE,
        UNUSABLE as UNUSABLE,
        FrameBlock as FrameBlock,
        ReadingFlag as ReadingFlag,
        ReadOptions as ReadOptions,
        Recording as Recording,
        SampleBlock as SampleBlock,
        ScanKind as ScanKind,
        VoltageUnit as VoltageUnit,
        join_frames as join_frames,
        join_samples as join_samples,
    )
    from .rules import (
        DEAD_SLOPE as DEAD_SLOPE,
        DEAD_SPREAD as DEAD_SPREAD,
        FEWEST_OF_PAIR as FEWEST_OF_PAIR,
        MOST_SPIKES as MOST_SPIKES,
        SILENT_SPREAD as SILENT_SPREAD,
        SOUND_SLOPE as SOUND_SLOPE,
        SPIKE_SIGMA as SPIKE_SIGMA,
        left_alone as left_alone,
    )

door(__name__, __file__)
