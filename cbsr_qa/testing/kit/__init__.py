"""Packages of plugins: made from templates, and checked whether installed or not."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .conformance import (
        CheckedPlugins as CheckedPlugins,
        assert_conforms as assert_conforms,
        check_plugins as check_plugins,
    )
    from .new import NewPackage as NewPackage, make_package as make_package
    from .package import targets_of as targets_of
    from .report import checks_outcome as checks_outcome

door(__name__, __file__)
