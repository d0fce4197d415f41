from .golden_lot import LotChoice as LotChoice, measuring_digest as measuring_digest, read_serials as read_serials
from .proposals import Proposal as Proposal, Terms as Terms, write_new as write_new
from .propose import SIZELESS as SIZELESS, ProposedLimits as ProposedLimits, propose_limits as propose_limits
