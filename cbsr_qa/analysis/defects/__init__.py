"""Defects of readings, found, masked or repaired: of recordings, of runs, and of frames as they arrive."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .channels import ChannelFaults as ChannelFaults, find_faults as find_faults
    from .contacts import (
        Suspect as Suspect,
        open_electrodes as open_electrodes,
        suspect_in as suspect_in,
        suspects_of as suspects_of,
    )
    from .drives import DeadDrive as DeadDrive, find_dead_drives as find_dead_drives
    from .load_cell import limit_N as limit_N, stood_at_limit as stood_at_limit
    from .noise import (
        MAD_TO_SIGMA as MAD_TO_SIGMA,
        channel_noise as channel_noise,
        find_steps as find_steps,
        noise_report as noise_report,
    )
    from .offsets import (
        find_offsets as find_offsets,
        offset_words as offset_words,
        without_offsets as without_offsets,
    )
    from .quality import (
        FEWEST_FRAMES as FEWEST_FRAMES,
        largest_by_reading as largest_by_reading,
        off_the_line as off_the_line,
        reciprocity_errors as reciprocity_errors,
        signal_to_noise_dB as signal_to_noise_dB,
    )
    from .rectifying import answering_levels as answering_levels
    from .spikes import despiked as despiked

door(__name__, __file__)
