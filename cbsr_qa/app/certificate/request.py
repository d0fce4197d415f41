"""Requests for certificates, and the settings that a certificate follows."""

import json
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

from cbsr_qa.config.documents import Document, DocumentKind
from cbsr_qa.config.loader import load_certificate_settings
from cbsr_qa.config.serials import validate_line, validate_reason
from cbsr_qa.config.station import CertificateFile
from cbsr_qa.config.tables import validate
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.plan import CertificateSettings
from cbsr_qa.domain.results.certificate import Customer

#: Longest name or address of a customer [characters]: a line or two of the page.
_LONGEST_CUSTOMER: Final = 120


#: Codes of ISO 3166-1 (alpha-2) of countries and territories, as assigned by 2026, and those that users may assign.
_COUNTRIES: Final = re.compile(
    "A[ADEFGILMOQRSTUWXZ]|B[ABDEFGHIJLMNOQRSTVWYZ]|C[ACDFGHIKLMNORUVWXYZ]|D[EJKMOZ]|E[CEGHRST]|F[IJKMOR]"
    "|G[ABDEFGHILMNPQRSTUWY]|H[KMNRTU]|I[DELMNOQRST]|J[EMOP]|K[EGHIMNPRWYZ]|L[ABCIKRSTUVY]"
    "|M[ACDEFGHKLMNOPQRSTUVWXYZ]|N[ACEFGILOPRUZ]|OM|P[AEFGHKLMNRSTWY]|Q[AM-Z]|R[EOSUW]"
    "|S[ABCDEGHIJKLMNORSTVXYZ]|T[CDFGHJKLMNORTVWZ]|U[AGMSYZ]|V[ACEGINU]|W[FS]|X[A-Z]|Y[ET]|Z[AMWZ]"
)


@dataclass(frozen=True, slots=True)
class CertificateRequest:
    """Certificates to issue; see the options of ``cbsr-qa certificate``.

    Parameters
    ----------
    folder : folder to write to; it may exist.
    customer : whom the certificates are for.
    settings_file : file with ``[certificate]``; None for that of the station, as each run was configured with it.
    overrides : keys of ``[certificate]`` that were given on the command line.
    key : file with the private key that signs; None for that of the station; without either they are not signed.
    replaces, why : number of the certificate to replace, and the reason; empty without.
    """

    folder: Path
    customer: Customer = field(default_factory=Customer)
    settings_file: Path | None = None
    overrides: dict[str, float | str] = field(default_factory=dict)
    key: Path | None = None
    replaces: str = ""
    why: str = ""

    def validate(self) -> "CertificateRequest":
        """Return itself with tidy texts.

        Raises
        ------
        ConfigError
            If customer or reason cannot be printed, or a replacement has no reason.
        RefusedError
            If the folder is a file.
        """
        customer = Customer(
            validate_line(self.customer.name, "--customer", _LONGEST_CUSTOMER),
            validate_line(self.customer.address, "--customer-address", _LONGEST_CUSTOMER),
        )
        if bool(self.replaces) is not bool(self.why.strip()):
            raise ConfigError(
                "--replaces and --reason are given together",
                remedy="name the certificate that is replaced, and say why: the new one states both",
            )
        if self.folder.exists() and not self.folder.is_dir():
            raise ConfigError(f"--to {self.folder} exists, and is not a folder", remedy="name a folder")
        return replace(self, customer=customer, why=validate_reason(self.why))


def choose_settings(request: CertificateRequest, configuration: str) -> tuple[CertificateSettings, Path | None]:
    """Return what a certificate states of the laboratory, and the file of the key that signs it.

    Parameters
    ----------
    configuration : canonical JSON that the run was configured with.

    Raises
    ------
    ConfigError
        If neither the request nor the station states the laboratory, or a value is not allowed; options are named.
    """
    station = json.loads(configuration)["station"]
    if request.settings_file is not None:
        document = load_certificate_settings(str(request.settings_file)).document
        stated = document.data["certificate"]
    elif "certificate" in station:
        stated = station["certificate"]
    else:
        raise ConfigError(
            f"station {station['station']['name']!r} states no laboratory: its file had no [certificate]",
            remedy="give a file with that table, its own or a station's: --laboratory FILE",
        )
    settings = load_certificate_settings({"certificate": stated}).value
    if request.overrides:
        label = ", ".join(f"--{name.replace('_', '-')}" for name in request.overrides)
        changed = {"certificate": {**stated, **request.overrides}}
        settings = validate(CertificateFile, Document(DocumentKind.CERTIFICATE, label, None, "", changed))
    if _COUNTRIES.fullmatch(settings.country) is None:  # not where files are read: stored runs have such stations
        raise ConfigError(
            f"certificate.country is {settings.country!r}, no code of ISO 3166-1",
            remedy='correct it ("GB" is the United Kingdom), or give a file with that table: --laboratory FILE',
        )
    named = station.get("calibrations", {}).get("signing_key")
    return settings, request.key or (None if named is None else Path(named))
