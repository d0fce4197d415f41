"""The chain of digests of a run, and its verification."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .check import (
        ALL_KINDS as ALL_KINDS,
        IDENTITY as IDENTITY,
        RESTORE as RESTORE,
        RESULTS as RESULTS,
        chain_state as chain_state,
        check_run as check_run,
        data_digest as data_digest,
        of_run as of_run,
        stored_documents as stored_documents,
        unreadable as unreadable,
    )
    from .fleet import (
        Figures as Figures,
        Known as Known,
        check_figures as check_figures,
        figures_query as figures_query,
    )
    from .links import (
        KEY_OPTION as KEY_OPTION,
        OF_A_SESSION as OF_A_SESSION,
        PLAIN as PLAIN,
        SigningKey as SigningKey,
        add_links as add_links,
        add_rows as add_rows,
        chain_head as chain_head,
        checking_key as checking_key,
        few_links as few_links,
        key_id_of as key_id_of,
        key_to_continue as key_to_continue,
        link_digest as link_digest,
        new_chain as new_chain,
        signing_key as signing_key,
        take_turns as take_turns,
    )
    from .many_rows import (
        documents_in_columns as documents_in_columns,
        keys_of as keys_of,
        row_texts as row_texts,
    )
    from .many_runs import (
        RUNS_AT_ONCE as RUNS_AT_ONCE,
        ReadRows as ReadRows,
        altered_runs as altered_runs,
        read_rows as read_rows,
    )
    from .run_documents import (
        BETWEEN as BETWEEN,
        FIGURES as FIGURES,
        JOINED as JOINED,
        KEYS as KEYS,
        covered as covered,
        documents as documents,
        facts as facts,
        row_text as row_text,
        sha256 as sha256,
        shown as shown,
        stored_figures as stored_figures,
        tables as tables,
        words as words,
    )

door(__name__, __file__)
