from .comparison import Comparison as Comparison, compare as compare
from .describe import Group as Group
from .differences import Difference as Difference
from .from_store import (
    RunChoice as RunChoice,
    compare_groups as compare_groups,
    read_amounts as read_amounts,
    read_groups as read_groups,
)
from .page import write_page as write_page
from .terms import (
    Adjustment as Adjustment,
    By as By,
    Period as Period,
    Policy as Policy,
    Quarantine as Quarantine,
    Terms as Terms,
)
from .wording import headline as headline, p_words as p_words, rules as rules, sentences as sentences
