"""Bearers: who shows a token, what that lets them do, and what is theirs."""

import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from ipaddress import IPv6Address, ip_address, ip_network
from pathlib import Path
from typing import Any

TOKEN_SCOPES = ("look", "bake", "upload", "admin")
"""What a token may allow: to see pictures of what is baked; to have light baked, by looking too,
and to dismiss one's own jobs; to upload volumes, and delete one's own; and everything, /metrics and
what is others' among it."""

MIN_TOKEN_CHARACTERS = 16
"""Characters of a token, at least."""


@dataclass(frozen=True)
class Bearer:
    """Who shows a ``token``: a ``name``, empty where the server has one token or none, and the
    ``scopes``.
    """

    token: str = field(default="", repr=False)
    name: str = ""
    scopes: frozenset[str] = frozenset(TOKEN_SCOPES)

    def may(self, scope: str) -> bool:
        """Whether the token allows what the scope stands for."""
        return scope in self.scopes or "admin" in self.scopes

    @property
    def reach(self) -> int:
        """How many scopes the token allows."""
        return sum(map(self.may, TOKEN_SCOPES))

    def owns(self, owner: str) -> bool:
        """Whether what belongs to an ``owner``, or to nobody where that is empty, is this one's to
        change.
        """
        return owner in ("", self.name) or "admin" in self.scopes


ANY_BEARER = Bearer()
"""Whoever asks a server that wants no token."""

TOKENLESS_BEARER = Bearer(scopes=frozenset())
"""Whoever asks without a token what is open to probes, where the server wants one."""

BEARER_SCOPE_KEY = "isogi.bearer"
"""Where a request's scope (ASGI) holds its bearer."""


def bearer_of(scope: Mapping[str, Any]) -> Bearer:
    """Who sends a request or opens a socket, by its ASGI ``scope``."""
    bearer = scope.get(BEARER_SCOPE_KEY, ANY_BEARER)
    assert isinstance(bearer, Bearer)
    return bearer


SITE_PREFIX_BITS = 64
"""Leading bits of an IPv6 address that stand for one client: each has all addresses that begin
so.
"""


def client_of(scope: Mapping[str, Any]) -> tuple[str, str]:
    """Who counts as one client where clients share: a bearer's name, and the address that the
    request comes from.
    """
    host = (scope.get("client") or ("",))[0]
    return bearer_of(scope).name, site_of(host)


def site_of(host: str) -> str:
    """The address as limits count it: a network of SITE_PREFIX_BITS bits for IPv6, where one client
    has many.
    """
    try:
        address = ip_address(host)
    except ValueError:
        return host
    if isinstance(address, IPv6Address) and address.ipv4_mapped:
        return str(address.ipv4_mapped)
    if address.version == 4:
        return host
    return str(ip_network((int(address), SITE_PREFIX_BITS), strict=False))


def read_bearers(path: Path) -> tuple[Bearer, ...]:
    """The bearers in a TOML file: tables by name, each with a ``token`` and ``scopes``. Raises
    ValueError.
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
    """One bearer. Raises ValueError, which names no token."""
    some = list(TOKEN_SCOPES[:2])
    right = (
        f"[{name}] must have a token of {MIN_TOKEN_CHARACTERS} characters or more, and "
        f"scopes, such as {some}"
    )
    if not isinstance(table, dict) or set(table) != {"token", "scopes"} or not name:
        raise ValueError(right)
    token = table["token"]
    scopes = table["scopes"]
    if not isinstance(token, str) or len(token) < MIN_TOKEN_CHARACTERS or not are_scopes(scopes):
        raise ValueError(f"{right}; scopes are {', '.join(TOKEN_SCOPES)}")
    return Bearer(token, name, frozenset(scopes))


def are_scopes(given: object) -> bool:
    """Whether these are scopes, and any at all."""
    return (
        isinstance(given, Collection)
        and bool(given)
        and all(each in TOKEN_SCOPES for each in given)
    )
