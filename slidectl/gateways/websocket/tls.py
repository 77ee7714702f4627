"""The certificate of the gateway, looked at before anybody connects."""

from __future__ import annotations

import ssl

from slidectl.errors import BadFile


def server_context(cert: str, key: str) -> ssl.SSLContext:
    """What serves TLS with the certificate (PEM, its chain after it) and the key, which may be in the same file.

    Raises:
        BadFile: a file cannot be read or is none, they do not belong together, or the certificate is not valid today.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    files = cert if not key else f"{cert} and {key}"

    def no_password() -> str:
        raise BadFile(f"the key in {key or cert} is encrypted", "write it without: openssl pkey -in KEY -out NEW")

    try:
        context.load_cert_chain(cert, key or None, no_password)
    except ssl.SSLError as error:
        reasons = {"KEY_VALUES_MISMATCH": "the key is not that of the certificate"}
        reason = reasons.get(error.reason or "", "they do not hold a certificate and its key as PEM")
        raise BadFile(f"{files} cannot be used: {reason}", "options: --cert FILE --key FILE") from None
    except OSError as error:
        raise BadFile(f"{files} cannot be read: {error.strerror}", "options: --cert FILE --key FILE") from None
    _check_dates(context, cert)
    return context


def _check_dates(context: ssl.SSLContext, cert: str) -> None:
    """Shake hands with a client in memory that trusts this very certificate. Raises BadFile."""
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname = False
    trusting.verify_flags = ssl.VerifyFlags.VERIFY_X509_PARTIAL_CHAIN
    trusting.load_verify_locations(cert)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = context.wrap_bio(to_server, to_client, server_side=True)
    client = trusting.wrap_bio(to_client, to_server)
    for side in (client, server, client):
        try:
            side.do_handshake()
        except ssl.SSLWantReadError:
            continue
        except ssl.SSLCertVerificationError as error:
            hint = f"look at it: openssl x509 -noout -dates -in {cert}"
            raise BadFile(f"no browser will take {cert}: {error.verify_message}", hint) from None
