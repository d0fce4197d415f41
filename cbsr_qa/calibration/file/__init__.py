"""The calibration file: HDF5, JSON, firmware."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .content import FLAG as FLAG, INDEX as INDEX, PURE as PURE, TEXT as TEXT, Entry as Entry
    from .entries import Issued as Issued, decode as decode, encode as encode
    from .firmware import (
        firmware_document as firmware_document,
        measure_loss as measure_loss,
        thin_model as thin_model,
    )
    from .hdf5 import (
        BLOCK_BEGINS as BLOCK_BEGINS,
        calibration_of as calibration_of,
        read_calibration as read_calibration,
        read_contained as read_contained,
        read_in_child as read_in_child,
        read_issued as read_issued,
        require_run_calibration as require_run_calibration,
        sign_calibration as sign_calibration,
        stamp as stamp,
        verify_calibration_file as verify_calibration_file,
        write_calibration as write_calibration,
    )
    from .hdf5_content import attribute as attribute, attribute_names as attribute_names, members as members
    from .json import (
        json_document as json_document,
        read_json_calibration as read_json_calibration,
        verify_json_calibration as verify_json_calibration,
    )
    from .keys import (
        SigningKey as SigningKey,
        new_key as new_key,
        passphrase as passphrase,
        public_path as public_path,
        signing_key as signing_key,
    )
    from .signing import check_signed_file as check_signed_file

door(__name__, __file__)
