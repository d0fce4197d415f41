"""Vocabulary shared by all layers and plugins: errors, numbers, geometry, plans, runs, results."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import errors as errors
    from .errors import (
        AT_COMMAND_LINE as AT_COMMAND_LINE,
        LONGEST_PROBLEM as LONGEST_PROBLEM,
        AbortedError as AbortedError,
        BrokenError as BrokenError,
        BrokenRunError as BrokenRunError,
        CalibrationError as CalibrationError,
        CbsrError as CbsrError,
        ConfigError as ConfigError,
        DeliveryError as DeliveryError,
        InstrumentError as InstrumentError,
        NoMoreFramesError as NoMoreFramesError,
        NotReproducedError as NotReproducedError,
        NumericsError as NumericsError,
        PluginError as PluginError,
        RecordingError as RecordingError,
        RefusedError as RefusedError,
        RowProblem as RowProblem,
        SafetyError as SafetyError,
        StoppedError as StoppedError,
        StoreError as StoreError,
        UnconcludedError as UnconcludedError,
        off_command_line as off_command_line,
    )
    from .filling import filled as filled, fitted as fitted, typed as typed
    from .goodness import (
        ALLOWANCE as ALLOWANCE,
        LEAST_EXPLAINED as LEAST_EXPLAINED,
        Goodness as Goodness,
        explained_share as explained_share,
        unlike_model as unlike_model,
    )
    from .kept import (
        COLUMNS as COLUMNS,
        Kept as Kept,
        KeptField as KeptField,
        as_filed as as_filed,
        group_of as group_of,
        in_steps as in_steps,
        kept_fields as kept_fields,
        tabulated as tabulated,
        taken as taken,
    )
    from .numbers import (
        Array as Array,
        Indices as Indices,
        Mask as Mask,
        array_of as array_of,
        check_encodable as check_encodable,
        did_you_mean as did_you_mean,
        finite_numbers as finite_numbers,
        of_kind as of_kind,
        real_numbers as real_numbers,
        with_type as with_type,
    )

door(__name__, __file__)
