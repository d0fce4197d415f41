"""What is known of the chain of digests a stored run is under."""

from dataclasses import dataclass
from typing import Any, Final

_NONE: Final = (
    "no chain: from before version 0011 of the database, or the chain was removed; changed rows cannot be told"
)


@dataclass(frozen=True, slots=True)
class ChainState:
    """State of a run's chain after every link of it was checked; a broken chain is refused instead.

    Parameters
    ----------
    links : how many; 0 for a run without a chain, which is unchained.
    key_id : identifies the key that signed the links, and tells nothing of the key; empty where nothing is signed.
    verified : whether the signatures were checked; False also where there are none.
    """

    links: int = 0
    key_id: str = ""
    verified: bool = False

    @property
    def words(self) -> str:
        """The state in words, for reports and terminals."""
        if not self.links:
            return _NONE
        if not self.key_id:
            return "chained, not signed"
        if self.verified:
            return f"chained and signed (key {self.key_id})"
        return f"chained; signatures not checked, key {self.key_id} is not set here"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the run is to warn of: rows that nothing vouches for."""
        return () if self.links else (f"rows of this run: {self.words}",)

    def document(self) -> dict[str, Any]:
        """Return the state as a JSON object."""
        state = "unchained" if not self.links else "chained"
        signature = "none" if not self.key_id else "checked" if self.verified else "not checked"
        return {"state": state, "signature": signature, "key_id": self.key_id or None}
