"""Bearers of tokens: their rights and their property; and clients, as limits count them."""

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from ipaddress import IPv6Address, ip_address, ip_network
from pathlib import Path
from typing import Any

TOKEN_SCOPES = ("look", "bake", "upload", "admin")
"""Scopes of a token. look: see pictures with the light that is baked. bake: also have light
baked, and dismiss the bearer's jobs. upload: also upload volumes, and delete the bearer's.
admin: everything, including /metrics and what belongs to others.
"""

MIN_TOKEN_CHARACTERS = 16
"""Characters of a token, at least."""


@dataclass(frozen=True)
class Bearer:
    """The bearer of a ``token``: a ``name``, empty if the server has one token or none, and the
    ``scopes``.
    """

    token: str = field(default="", repr=False)
    name: str = ""
    scopes: frozenset[str] = frozenset(TOKEN_SCOPES)

    def may(self, scope: str) -> bool:
        """Return True if the token has this scope, or is an admin's."""
        return scope in self.scopes or "admin" in self.scopes

    @property
    def reach(self) -> int:
        """Return the number of scopes that the token allows."""
        return sum(map(self.may, TOKEN_SCOPES))

    def owns(self, owner: str) -> bool:
        """Return True if the bearer may change what belongs to ``owner``; an empty owner is
        nobody.
        """
        return owner in ("", self.name) or "admin" in self.scopes


ANY_BEARER = Bearer()
"""The bearer of all requests if the server requires no token."""

TOKENLESS_BEARER = Bearer(scopes=frozenset())
"""The bearer of requests without a token to paths for probes, if the server requires one."""

BEARER_SCOPE_KEY = "isogi.bearer"
"""Key of the bearer in a request's ASGI scope."""


def bearer_of(scope: Mapping[str, Any]) -> Bearer:
    """Return the bearer of a request or socket, by its ASGI ``scope``."""
    bearer = scope.get(BEARER_SCOPE_KEY, ANY_BEARER)
    assert isinstance(bearer, Bearer)
    return bearer


SITE_PREFIX_BITS = 64
"""Leading bits of an IPv6 address that identify one client: it has all addresses that begin so."""


def client_of(scope: Mapping[str, Any]) -> tuple[str, str]:
    """Return the client of a request as limits count it: the name of its bearer, and its
    address.
    """
    host = (scope.get("client") or ("",))[0]
    return bearer_of(scope).name, site_of(host)


def site_of(host: str) -> str:
    """Return an address as limits count it: for IPv6, the network of SITE_PREFIX_BITS bits, as
    one client has many addresses.
    """
    try:
        address = ip_address(host)
    except ValueError:
        return host
    # An IPv4 client of a dual-stack socket is counted by its IPv4 address.
    if isinstance(address, IPv6Address) and address.ipv4_mapped:
        return str(address.ipv4_mapped)
    if address.version == 4:
        return host
    return str(ip_network((int(address), SITE_PREFIX_BITS), strict=False))


def read_bearers(path: Path) -> tuple[Bearer, ...]:
    """Read the bearers in a TOML file: tables by name, each with a ``token`` and ``scopes``.
    Raises ValueError.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"the tokens in {path} cannot be read: {error}") from None
    bearers = tuple(read_bearer(name, table) for name, table in tables.items())
    if not bearers or len({bearer.token for bearer in bearers}) < len(bearers):
        raise ValueError(f"{path} must hold tokens, each another one")
    return bearers


def read_bearer(name: str, table: Any) -> Bearer:
    """Read one bearer. Raises ValueError, whose message holds no token."""
    some = list(TOKEN_SCOPES[:2])
    right = (
        f"[{name}] must have a token of {MIN_TOKEN_CHARACTERS} characters or more, and "
        f"scopes, such as {some}"
    )
    if not isinstance(table, dict) or set(table) != {"token", "scopes"} or not name:
        raise ValueError(right)
    # Never quote the token in an error: it may be logged.
    token = table["token"]
    scopes = table["scopes"]
    if not isinstance(token, str) or len(token) < MIN_TOKEN_CHARACTERS or not are_scopes(scopes):
        raise ValueError(f"{right}; scopes are {', '.join(TOKEN_SCOPES)}")
    return Bearer(token, name, frozenset(scopes))


def are_scopes(given: object) -> bool:
    """Return True if ``given`` is a collection of scopes that is not empty."""
    return (
        isinstance(given, Collection)
        and bool(given)
        and all(each in TOKEN_SCOPES for each in given)
    )
