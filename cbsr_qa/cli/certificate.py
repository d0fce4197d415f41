"""``cbsr-qa certificate``: issue, verify, replace and revoke calibration certificates."""

from pathlib import Path
from typing import Annotated

import typer

from cbsr_qa.cli.command import command, group
from cbsr_qa.cli.options import AsJson, Database, PublicKey, Withdrawn
from cbsr_qa.cli.output import Counting, show
from cbsr_qa.domain.errors import RefusedError

group(
    "certificate",
    "Issue, verify, list and revoke calibration certificates; a serial number alone issues one.",
    default="issue",
)

_Key = Annotated[Path | None, typer.Option(help="Private key that signs; by default signing_key of the station.")]
_Number = Annotated[str, typer.Argument(help="Number of the certificate.")]


@command(
    "certificate issue",
    prints="cbsr_qa.app.certificate.issue:CertificateFiles|cbsr_qa.app.certificate.issue:BatchCertificates",
    reads="cbsr_qa.app.certificate.issue",
)
def issue(
    serial: Annotated[
        str | None, typer.Argument(help="Serial number of a sensor: its latest run; or a run.", show_default=False)
    ] = None,
    *,
    to: Annotated[Path, typer.Option("--to", metavar="FOLDER", help="Folder to write to.")],
    batch: Annotated[str | None, typer.Option(help="Every sensor of this batch, in place of SERIAL.")] = None,
    customer: Annotated[str, typer.Option(help="Name of the customer.")] = "",
    customer_address: Annotated[str, typer.Option(help="Address of the customer.")] = "",
    laboratory: Annotated[
        Path | None,
        typer.Option(
            help="File with a certificate table, its own or a station's; by default that of the run's station."
        ),
    ] = None,
    signatory: Annotated[str | None, typer.Option(help="Who authorises it, in place of the file's.")] = None,
    validity_months: Annotated[
        int | None, typer.Option(help="Months of validity from the calibration on, in place of the file's.")
    ] = None,
    max_error_N: Annotated[
        float | None,
        typer.Option("--max-error-N", help="Maximum permissible error [N], in place of the file's."),
    ] = None,
    max_error_percent: Annotated[
        float | None, typer.Option(help="And its part relative to the force [%], in place of the file's.")
    ] = None,
    no_max_error: Annotated[
        bool, typer.Option("--no-max-error", help="No maximum permissible error, and no statement of conformity.")
    ] = False,
    decision: Annotated[
        str | None, typer.Option(metavar="guarded|simple", help="Decision rule, in place of the file's.")
    ] = None,
    key: _Key = None,
    replaces: Annotated[str, typer.Option(metavar="NUMBER", help="Certificate that this one replaces.")] = "",
    reason: Annotated[str, typer.Option(help="Why that one is replaced.")] = "",
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Issue the calibration certificate of a sensor: a page of two sides, and a digital certificate (XML).

    Exit code 1 if sensors of a batch got none.
    """
    from cbsr_qa.app.certificate.issue import issue_batch, issue_certificate
    from cbsr_qa.app.certificate.request import CertificateRequest
    from cbsr_qa.domain.results.certificate import Customer

    requirement = {"max_error_N": max_error_N, "max_error_percent": max_error_percent, "decision": decision}
    if no_max_error:
        if any(value is not None for value in requirement.values()):
            raise RefusedError("--no-max-error with a maximum permissible error or --decision", remedy="give one")
        requirement = {"max_error_N": 0.0, "max_error_percent": 0.0, "decision": ""}
    given = {
        "signatory": signatory,
        "validity_months": validity_months,
        **requirement,
    }
    request = CertificateRequest(
        folder=to,
        customer=Customer(customer, customer_address),
        settings_file=laboratory,
        overrides={name: value for name, value in given.items() if value is not None},
        key=key,
        replaces=replaces,
        why=reason,
    )
    if (serial is None) is (batch is None):
        raise RefusedError("give SERIAL or --batch", remedy="one of them says which sensors are certified")
    if serial is not None:
        return show(issue_certificate(serial, request, database=database), as_json=as_json)
    assert batch is not None
    with Counting("certificates") as counting:
        counting.stage("issuing certificates")
        outcome = issue_batch(batch, request, counting.count, database=database)
    return show(outcome, as_json=as_json)


@command(
    "certificate verify",
    prints="cbsr_qa.app.certificate.verify:VerifiedCertificate",
    reads="cbsr_qa.app.certificate.verify",
)
def verify(
    file: Annotated[Path, typer.Argument(help="Page or XML of a certificate.")],
    public_key: PublicKey = None,
    signature: Annotated[
        Path | None, typer.Option(help="Its signature file; by default NUMBER.signature.json beside it.")
    ] = None,
    withdrawn: Withdrawn = None,
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Check that a certificate is unchanged, signed, in date, and neither replaced nor revoked.

    It is compared with its signature file and with the database, whichever is there; in the database its run is
    checked too, with every frame; what was removed from its end together with its links is not noticed. Exit code 1
    unless it is valid, and signed by the key that --public-key names or recorded in the database.
    """
    from cbsr_qa.app.certificate.verify import verify_certificate

    outcome = verify_certificate(
        file, public_key=public_key, signature=signature, withdrawn=withdrawn, database=database
    )
    return show(outcome, as_json=as_json)


@command("certificate revoke", prints="cbsr_qa.app.certificate.withdraw:ListedCertificate")
def revoke(
    number: _Number,
    reason: Annotated[str, typer.Option(help="Why it no longer holds.")],
    by: Annotated[str, typer.Option(metavar="NAME", help="Who revokes it.")] = "",
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Revoke a certificate, with a reason that is kept beside it; nothing of it is removed."""
    from cbsr_qa.app.certificate.withdraw import revoke_certificate

    return show(revoke_certificate(number, by=by, why=reason, database=database), as_json=as_json)


@command("certificate list", prints="cbsr_qa.app.certificate.withdraw:CertificateList")
def list_certificates(
    serial: Annotated[str | None, typer.Argument(help="Serial number of a sensor; by default all.")] = None,
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """List certificates, and what became of them."""
    from cbsr_qa.app.certificate.withdraw import list_certificates

    return show(list_certificates(serial, database=database), as_json=as_json)


@command("certificate copy", prints="cbsr_qa.app.certificate.withdraw:WrittenFiles")
def copy(
    number: _Number,
    to: Annotated[Path, typer.Option("--to", metavar="FOLDER", help="Folder to write to.")],
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Write the files of a certificate again, as they were issued."""
    from cbsr_qa.app.certificate.withdraw import copy_certificate

    return show(copy_certificate(number, to, database=database), as_json=as_json)


@command("certificate withdrawn", prints="cbsr_qa.app.certificate.withdraw:WrittenFiles")
def withdrawn(
    to: Annotated[
        Path, typer.Option("--to", metavar="FILE", help="List to write, JSON; an earlier one is replaced.")
    ],
    key: Annotated[Path, typer.Option(help="Private key that signs the list.")],
    database: Database = None,
    as_json: AsJson = False,
) -> int:
    """Write the signed list of certificates that were replaced or revoked, for robots and customers."""
    from cbsr_qa.app.certificate.withdraw import write_withdrawn

    return show(write_withdrawn(to, key, database=database), as_json=as_json)
