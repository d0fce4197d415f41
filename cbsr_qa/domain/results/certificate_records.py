"""Certificates as a database keeps them: what was issued, and what became of it."""

from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True, slots=True, kw_only=True)
class IssuedCertificate:
    """A certificate as it was issued.

    Parameters
    ----------
    number : unique: the laboratory's prefix and the run.
    run, calibration : what it certifies.
    signatory : person who authorised it.
    valid_until : ISO date; None where no validity was stated.
    replaces, why : number of the certificate that it replaces, and the reason; None and empty without.
    html, dcc : bytes of its page and of its digital calibration certificate (XML).
    signature : text of its signature file; None if it is not signed.
    """

    number: str
    run: str
    calibration: str
    issued_at: datetime
    signatory: str
    valid_until: str | None
    replaces: str | None
    why: str
    html: bytes
    dcc: bytes
    signature: str | None


@dataclass(frozen=True, slots=True)
class CertificateWithdrawal:
    """A certificate was replaced, or revoked (``replaced_by`` is None)."""

    number: str
    replaced_by: str | None
    operator: str
    why: str
    noted_at: datetime

    @property
    def words(self) -> str:
        """What became of the certificate, e.g. ``revoked on 2027-03-31 by Ada: …``."""
        what = "revoked" if self.replaced_by is None else f"replaced by certificate {self.replaced_by}"
        return f"{what} on {self.noted_at:%Y-%m-%d} by {self.operator}: {self.why}"


@dataclass(frozen=True, slots=True)
class StoredCertificate:
    """A certificate with the serial number of its sensor.

    Parameters
    ----------
    withdrawals : none while it stands; two if it was revoked and then replaced.
    """

    issued: IssuedCertificate
    serial: str
    withdrawals: tuple[CertificateWithdrawal, ...]

    @property
    def withdrawn(self) -> str:
        """What became of the certificate, in words; empty while it stands."""
        return "; ".join(withdrawal.words for withdrawal in self.withdrawals)

    @property
    def is_replaced(self) -> bool:
        return any(withdrawal.replaced_by is not None for withdrawal in self.withdrawals)
