"""Certificates of a new key, which is its own authority."""

from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from distributed import Security

CERTIFICATE_NAME = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "isogi")])

CERTIFICATE_LIFETIME = timedelta(days=36500)
"""How long a certificate is good: longer than any process. Dask's own temporary ones end after a
year.
"""

KEY_ENCODING = (
    serialization.Encoding.PEM,
    serialization.PrivateFormat.PKCS8,
    serialization.NoEncryption(),
)


def temporary_security() -> Security:
    """TLS for both sides of each connection, with a new key whose certificate is its own authority.

    Only who has the key can connect, and only to who has it. Workers have it through the pipe of
    their start.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = own_certificate(key).public_bytes(serialization.Encoding.PEM).decode()
    roles = ("client", "scheduler", "worker")
    return Security(
        require_encryption=True,
        tls_ca_file=certificate,
        **{f"tls_{role}_cert": certificate for role in roles},
        **{f"tls_{role}_key": key.private_bytes(*KEY_ENCODING).decode() for role in roles},
    )


def own_certificate(key: ec.EllipticCurvePrivateKey) -> x509.Certificate:
    """A certificate for a key, signed with that key."""
    begun = datetime.now(UTC) - timedelta(days=1)
    unsigned = x509.CertificateBuilder(
        CERTIFICATE_NAME, CERTIFICATE_NAME, key.public_key(), x509.random_serial_number()
    )
    period = unsigned.not_valid_before(begun).not_valid_after(begun + CERTIFICATE_LIFETIME)
    authority = x509.BasicConstraints(ca=True, path_length=0)
    return period.add_extension(authority, critical=True).sign(key, hashes.SHA256())
