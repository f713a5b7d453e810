"""X.509 certificates for mutual TLS: an authority of the site's own, EC P-256, no passwords."""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Sequence
from typing import Any

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from e3pose.base.errors import InputError

SUBJECT = "e3pose "  # before the name of the site
AUTHORITY_DAYS = 3650
LEAF_DAYS = 825
# What certificates and keys that are none raise.
UNREADABLE = (
    ValueError,
    TypeError,
    x509.InvalidVersion,
    x509.ExtensionNotFound,
    UnsupportedAlgorithm,
)
CLOCK_SLACK = datetime.timedelta(days=1)  # a camera without a network may be behind


def make_authority(site: str, now: datetime.datetime) -> tuple[bytes, bytes]:
    """Return certificate and private key, PEM, of a new authority for one site."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"{SUBJECT}{site}"[:64])])
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SLACK)
        .not_valid_after(now + datetime.timedelta(days=AUTHORITY_DAYS))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM), _pem(key)


def make_certificate(
    authority: bytes,
    authority_key: bytes,
    common_name: str,
    hosts: Sequence[str],
    now: datetime.datetime,
    own: bytes = b"",
    public: ec.EllipticCurvePublicKey | None = None,
) -> tuple[bytes, bytes]:
    """Return certificate and private key, PEM, of one program.

    Args:
        authority: the authority's certificate, PEM.
        authority_key: its private key, PEM.
        common_name: by which access rules know the program.
        hosts: names and addresses under which it is reached.
        now: the time from which it is valid.
        own: the program's private key, PEM; a new one is made where it cannot be read.
        public: of a private key that is elsewhere: an empty one is returned.
    """
    issuer = x509.load_pem_x509_certificate(authority)
    issuer_key = serialization.load_pem_private_key(authority_key, password=None)
    if not isinstance(issuer_key, ec.EllipticCurvePrivateKey):
        raise ValueError("the key of the authority is no elliptic curve key")
    private = b""
    if public is None:
        try:
            key = serialization.load_pem_private_key(own, password=None)
        except UNREADABLE:
            key = None
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            key = ec.generate_private_key(ec.SECP256R1())
        private, public = _pem(key), key.public_key()
    certificate = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)]))
        .issuer_name(issuer.subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_SLACK)
        .not_valid_after(min(now + datetime.timedelta(days=LEAF_DAYS), issuer.not_valid_after_utc))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage(
                [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .add_extension(x509.SubjectAlternativeName([_host(h) for h in hosts]), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()),
            critical=False,
        )
        .sign(issuer_key, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM), private


def make_key() -> tuple[bytes, bytes]:
    """Return a new private key, PEM, and its public key as `read_public` takes it."""
    key = ec.generate_private_key(ec.SECP256R1())
    return _pem(key), _point(key.public_key())


def read_public(found: bytes) -> ec.EllipticCurvePublicKey:
    """Return a public key; raise `InputError` unless it is one on P-256."""
    try:
        return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), found)
    except ValueError:
        raise InputError("public key", f"{len(found)} other bytes", "a point on P-256") from None


def public_of(certificate: bytes) -> bytes:
    """Return the public key of a PEM certificate that was made here, as `read_public` takes it."""
    return _point(x509.load_pem_x509_certificate(certificate).public_key())


def _point(key: Any) -> bytes:
    form = serialization.PublicFormat.UncompressedPoint
    return bytes(key.public_bytes(serialization.Encoding.X962, form))


def common_name(certificate: bytes) -> str:
    """Return the common name of a PEM certificate."""
    subject = x509.load_pem_x509_certificate(certificate).subject
    return str(subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


def problem_with(
    certificate: bytes, key: bytes, authority: bytes, now: datetime.datetime
) -> str | None:
    """Return the problem of a program's certificate in words, None for none."""
    try:
        own = x509.load_pem_x509_certificate(certificate)
        issuer = x509.load_pem_x509_certificate(authority)
        private = serialization.load_pem_private_key(key, password=None)
    except UNREADABLE:  # whose words are of PEM and framing
        return "found no certificate or key, expected what `e3pose keys` made"
    if private.public_key() != own.public_key():
        return (
            "found a key that belongs to another certificate, expected both of one pair: "
            "`e3pose keys renew` with its name makes one; copy the folder to its machine"
        )
    try:
        own.verify_directly_issued_by(issuer)
    except (InvalidSignature, ValueError, TypeError):
        return "found a certificate of another authority"
    for what, item in (("", own), ("the authority's ", issuer)):
        if now < item.not_valid_before_utc:
            return f"{what}certificate is valid from {item.not_valid_before_utc:%Y-%m-%d %H:%M} UTC"
        if now > item.not_valid_after_utc:
            return f"{what}certificate expired on {item.not_valid_after_utc:%Y-%m-%d %H:%M} UTC"
    return None


def expires(certificate: bytes) -> datetime.datetime:
    """Return until when a PEM certificate is valid, UTC; raise `InputError` if it is none."""
    try:
        return x509.load_pem_x509_certificate(certificate).not_valid_after_utc
    except UNREADABLE:
        raise InputError("found no certificate or key, expected what `e3pose keys` made") from None


def hosts_of(certificate: bytes) -> list[str]:
    """Return the names and addresses that a PEM certificate is for."""
    found = x509.load_pem_x509_certificate(certificate)
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(name.value) for name in names]


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
