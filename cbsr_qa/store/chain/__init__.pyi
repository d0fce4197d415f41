from .check import (
    IDENTITY as IDENTITY,
    RESULTS as RESULTS,
    check_run as check_run,
    data_digest as data_digest,
    unreadable as unreadable,
)
from .fleet import (
    AT_ONCE as AT_ONCE,
    Figures as Figures,
    Known as Known,
    check_figures as check_figures,
    figures_query as figures_query,
)
from .links import (
    KEY_OPTION as KEY_OPTION,
    SigningKey as SigningKey,
    add_links as add_links,
    add_rows as add_rows,
    chain_head as chain_head,
    key_to_continue as key_to_continue,
    link_digest as link_digest,
    new_chain as new_chain,
)
from .run_documents import (
    BETWEEN as BETWEEN,
    FIGURES as FIGURES,
    JOINED as JOINED,
    RUN_COLUMNS as RUN_COLUMNS,
    documents as documents,
    facts as facts,
    phase_end as phase_end,
    stored_figures as stored_figures,
    words as words,
)
