"""The database: tables, journal, results, and their chain of digests."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .copies import copy_database as copy_database, put_back as put_back
    from .damage import address as address, shown as shown
    from .engine import (
        open_engine as open_engine,
        parsed_url as parsed_url,
        reading as reading,
        sqlite_file as sqlite_file,
        writing as writing,
    )
    from .locks import this_process as this_process
    from .opening import check_usable as check_usable, open_existing as open_existing, open_store as open_store
    from .repository import Repository as Repository
    from .roles import (
        READER as READER,
        STATION as STATION,
        roles_script as roles_script,
    )
    from .schema import (
        HEAD as HEAD,
        Age as Age,
        found_version as found_version,
        refusal as refusal,
        upgrade as upgrade,
    )
    from .types import (
        IdSource as IdSource,
        PlainText as PlainText,
        compact as compact,
        made_at as made_at,
        restored as restored,
    )
    from .views import create_views as create_views, drop_views as drop_views

door(__name__, __file__)
