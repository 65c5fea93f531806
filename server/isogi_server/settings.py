"""Settings of a process: options, environment variables ``ISOGI_…``, or lines of a TOML file."""

import os
import tomllib
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field, FilePath, PrivateAttr, SecretStr, field_validator, model_validator
from pydantic_settings import (
    BaseSettings,
    NoDecode,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    TomlConfigSettingsSource,
)

from isogi_server.bearers import Bearer, read_bearers

UNKNOWN_SCHEDULER = (
    "anybody who reaches a scheduler without certificates can run code there: name one at "
    "tls://… with scheduler_ca,"
    " scheduler_cert and scheduler_key (docs/cluster.md), or say --insecure-scheduler"
)

UPLOADS_MB = 2048
"""Megabytes that uploads may take by default if no other machine reaches the server."""

ANSWER_PIXELS = 1 << 22
COMMAND_PIXELS = 1 << 24
"""Most pixels in one picture by default, in answers of a server and in commands. A pixel takes up
to 150 bytes of memory while it is drawn.
"""

LOOPBACK_HOSTS = ("127.0.0.1", "localhost", "::1")
Names = Annotated[tuple[str, ...], NoDecode]
"""Names in a list, or in a text separated by commas."""


class Patience(NamedTuple):
    """How long a server waits for clients, and how much it takes from them: numbers that nobody
    needs to set. A proxy in front of the server may be stricter.

    ``head_seconds``, ``body_seconds``: for the head of a request, and for its body.
    ``stall_seconds``: for which a client may take less than 1 kB a second.
    ``idle_seconds``: for which a connection without a request is kept.
    ``unsent_mb``: megabytes of answers that clients have not taken yet; above that the slowest is
    closed.
    ``body_bytes``: most bytes in the body of a request; above that: 413.
    ``render_queue``: frames that may wait for a thread, each for ``queue_seconds``; else: 429.
    ``stream_bytes``, ``stream_rate``: most bytes of one message to a stream, and most messages in a
    second.
    ``stream_idle_seconds``: without a message, after which a stream is closed.
    """

    head_seconds: int = 10
    body_seconds: int = 10
    stall_seconds: int = 20
    idle_seconds: int = 5
    unsent_mb: int = 1024
    body_bytes: int = 64 * 1024
    render_queue: int = 64
    queue_seconds: float = 10.0
    stream_bytes: int = 16384
    stream_rate: int = 600
    stream_idle_seconds: float = 3600.0


FIXED = "is no setting any more, isogi keeps it at {}: remove it"

FORMER_SETTING_NAMES = {
    "sharp_mb": "is called projected_mb now: rename it",
    "max_unsent_mb": FIXED.format(Patience().unsent_mb),
    "max_body_bytes": FIXED.format(Patience().body_bytes),
    **{
        name: FIXED.format(f"{value:g}")
        for name, value in Patience()._asdict().items()
        if name not in ("unsent_mb", "body_bytes")
    },
}
"""Names of former settings, each with what is said of it."""


def cores() -> int:
    """Return the number of cores that this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


class Settings(BaseSettings):
    """The settings of one process. Raises pydantic's ValidationError."""

    model_config = SettingsConfigDict(env_prefix="ISOGI_", frozen=True, extra="forbid")

    host: str = Field("127.0.0.1", description="Address to listen on.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    workers: int = Field(
        default_factory=cores,
        ge=1,
        le=1024,
        description="Processes that compute light; default: one per core.",
    )
    store: str | None = Field(
        None, description="Path or URL of the light's store; default: in the user's cache folder."
    )
    store_seconds: float = Field(
        5, gt=0, le=600, description="Seconds for one call to an object store."
    )
    store_retries: int = Field(
        2,
        ge=0,
        le=100,
        description="Times that a call to an object store is tried again if it fails.",
    )
    store_cache_mb: int = Field(
        1024,
        ge=0,
        le=1 << 20,
        description="Megabytes of an object store's chunks that this machine's disk keeps.",
    )
    projected_mb: int = Field(
        4096,
        ge=0,
        le=1 << 30,
        description="Megabytes of projected texels, light for single isovalues, that the store "
        "keeps; the light unused longest is deleted when another isovalue is shown.",
    )
    memory_mb: int = Field(
        1024,
        ge=1,
        le=1 << 20,
        description="Megabytes of light, views and maps that all scenes together keep in memory.",
    )
    volume_mb: int = Field(
        2048,
        ge=1,
        le=1 << 20,
        description="Megabytes of voxels that a process has room for: volumes of at most an "
        "eighth of it are in memory, larger ones are mapped from a copy on the disk.",
    )
    volume_cache: str | None = Field(
        None,
        description=(
            "Folder of copies of volumes, on a disk of this machine; default: in the user's cache "
            "folder."
        ),
    )
    volume_cache_mb: int = Field(
        1 << 16,
        ge=0,
        le=1 << 30,
        description="Megabytes of copies of volumes; those used last are kept.",
    )
    scheduler: str | None = Field(
        None, description="Address of a Dask scheduler whose workers bake, tls://…"
    )
    scheduler_ca: FilePath | None = Field(
        None,
        description=(
            "File of the authority, PEM, that signed the certificates of that "
            "scheduler and its workers."
        ),
    )
    scheduler_cert: FilePath | None = Field(
        None, description="File of this server's certificate for the scheduler, PEM."
    )
    scheduler_key: FilePath | None = Field(None, description="File of that certificate's key, PEM.")
    insecure_scheduler: bool = Field(
        False,
        description=(
            "Join a scheduler without certificates: anybody who reaches it can run "
            "code as its workers' user."
        ),
    )
    token: SecretStr | None = Field(
        None,
        min_length=16,
        description="Token that clients send as 'Authorization: Bearer', or a browser once as "
        "/?token=; needed if the host is not loopback. It has no option, as all users of a "
        "machine see options.",
    )
    token_file: str | None = Field(
        None, description="File that holds the token, if the environment does not."
    )
    tokens_file: FilePath | None = Field(
        None,
        description=(
            "TOML file of tokens by name, each with its scopes: look, bake, upload, admin."
        ),
    )
    allowed_hosts: Names | None = Field(
        None,
        description="Host names that requests may use, comma-separated; default: the loopback "
        "names if the server listens on loopback (a defence against DNS rebinding), else any.",
    )
    allowed_origins: Names = Field(
        (),
        description=(
            "Origins such as https://lab.example whose pages may use this server, "
            "comma-separated; default: none."
        ),
    )
    trusted_proxies: Names = Field(
        (),
        description="Addresses or networks of proxies whose X-Forwarded-For and "
        "X-Forwarded-Proto are trusted, comma-separated; default: none.",
    )
    max_pixels: int | None = Field(
        None,
        ge=1,
        description=(
            "Most pixels in one picture; default: 4194304 in answers of a server, 16777216 in "
            "commands."
        ),
    )
    max_paths: int = Field(
        2**26, ge=1, description="Most paths (pixels × samples) in one path-traced picture."
    )
    uploads_mb: int | None = Field(
        None,
        ge=0,
        le=1 << 20,
        description="Megabytes that all uploads together may take; 0: no uploads; default: "
        f"{UPLOADS_MB} if only this machine reaches the server (on loopback, without "
        "allowed_hosts), else 0.",
    )
    uploads: str | None = Field(
        None, description="Folder of uploads; default: in the user's data folder."
    )
    max_upload_mb: int = Field(
        256,
        ge=1,
        le=1 << 16,
        description="Most megabytes of one upload, and of its voxels at 4 bytes each.",
    )
    upload_seconds: int = Field(300, ge=1, description="Seconds for an upload to arrive.")
    reading_seconds: float = Field(
        4,
        ge=0.1,
        description=("Seconds of processor time to read an upload, plus one for every 8 MB of it."),
    )
    exports_mb: int = Field(
        384,
        ge=0,
        le=1 << 16,
        description="Megabytes of exported files, each and all together; the newest are kept; "
        "0: no exports.",
    )
    hand_out_voxels: bool | None = Field(
        None,
        description="Hand out the voxels and the light of scenes, so that pages can draw them; "
        "default: yes, unless a token is required.",
    )
    max_connections: int = Field(512, ge=1, description="Connections at a time.")
    max_client_connections: int = Field(
        256, ge=1, description="Connections at a time from one address."
    )
    render_threads: int = Field(
        default_factory=lambda: max(4, 2 * cores()),
        ge=1,
        le=256,
        description="Frames rendered at a time; default: two per core, at least 4.",
    )
    streams: int = Field(
        64, ge=0, description="Streams and listeners to events at a time; above that: 429."
    )
    jobs: int = Field(16, ge=0, description="Jobs at a time; above that: 429.")
    shutdown_seconds: int = Field(
        10, ge=0, description="Seconds for which a stopping server completes open requests."
    )
    log_format: Literal["text", "json"] = Field(
        "text", description="Format of the log's lines: text or json."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "warning",
        description="Lowest level that is logged: debug, info (with each request), warning or "
        "error.",
    )

    @field_validator("host")
    @classmethod
    def address(cls, value: str) -> str:
        """Return the host if it is an address; raise ValueError for a Unix socket."""
        if value.startswith("unix:") or "/" in value:
            raise ValueError(
                "isogi listens at addresses, not at sockets of the file system: give one such "
                "as 127.0.0.1, and have a proxy listen at the socket"
            )
        return value

    @field_validator("allowed_hosts", "allowed_origins", "trusted_proxies", mode="before")
    @classmethod
    def split(cls, value: object) -> object:
        """Split a text at commas into names."""
        if isinstance(value, str):
            return tuple(filter(None, map(str.strip, value.split(","))))
        return value

    @field_validator("allowed_origins")
    @classmethod
    def origins(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Return the origins in lower case. Raises ValueError unless each is a scheme and a
        host; there is no wildcard.
        """
        for name in value:
            scheme, _, host = name.partition("://")
            if scheme not in ("http", "https") or not host or set("/*?#@") & set(host):
                raise ValueError(
                    f"{name} is no origin: write it as https://lab.example or http://localhost:8888"
                )
        return tuple(name.lower() for name in value)

    @field_validator("trusted_proxies")
    @classmethod
    def proxies(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        """Return the proxies. Raises ValueError unless each is an address or a network; there
        is no wildcard.
        """
        for name in value:
            try:
                ip_network(name)
            except ValueError:
                raise ValueError(
                    f"{name} is no address or network: write it as 127.0.0.1, fd00::1 or 10.0.0.0/8"
                ) from None
        return value

    _patience: Patience = PrivateAttr(default=Patience())

    @property
    def patience(self) -> Patience:
        """Return how long the server waits for clients."""
        return self._patience

    def with_patience(self, patience: Patience) -> Self:
        """Return these settings with another ``patience``, as tests need it."""
        changed = self.model_copy()
        changed._patience = patience
        return changed

    @model_validator(mode="before")
    @classmethod
    def renamed(cls, given: Any) -> Any:
        """Raise ValueError if a former name of a setting is given; else return the input."""
        for former in FORMER_SETTING_NAMES.keys() & dict(given):
            raise ValueError(f"{former} {FORMER_SETTING_NAMES[former]}")
        return given

    @model_validator(mode="before")
    @classmethod
    def token_from_file(cls, given: Any) -> Any:
        """Add the token that ``token_file`` holds, if no token is given."""
        if "token" in given or not given.get("token_file"):
            return given
        try:
            return {**given, "token": Path(given["token_file"]).read_text(encoding="utf-8").strip()}
        except (OSError, ValueError) as error:
            raise ValueError(f"the token cannot be read: {error}") from None

    @field_validator("tokens_file")
    @classmethod
    def tokens(cls, value: Path | None) -> Path | None:
        """Return the file if it holds valid tokens; else raise ValueError."""
        if value is not None:
            read_bearers(value)
        return value

    @model_validator(mode="after")
    def scheduler_is_known(self) -> Self:
        """Raise ValueError if a scheduler is named without certificates and without
        ``insecure_scheduler``.
        """
        known = all(self.certificates) and (self.scheduler or "").startswith("tls://")
        if self.scheduler and not (known or self.insecure_scheduler):
            raise ValueError(UNKNOWN_SCHEDULER)
        return self

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        *_: Any,
        **others: Any,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """Take options first, then the environment, then the file if there is one."""
        return init_settings, others["env_settings"], TomlConfigSettingsSource(settings_cls)

    @property
    def bearers(self) -> tuple[Bearer, ...]:
        """Return the bearers of all tokens; none if no token is required."""
        one = () if self.token is None else (Bearer(self.token.get_secret_value()),)
        return (*one, *(read_bearers(self.tokens_file) if self.tokens_file else ()))

    @property
    def certificates(self) -> tuple[Path | None, Path | None, Path | None]:
        """Return the files for a scheduler: authority, certificate, key."""
        return self.scheduler_ca, self.scheduler_cert, self.scheduler_key

    @property
    def exposed(self) -> bool:
        """Return True if other machines can reach the address that the server listens at."""
        try:
            return not ip_address(self.host).is_loopback
        except ValueError:
            return self.host != "localhost"

    @property
    def upload_quota_mb(self) -> int:
        """Return the megabytes that uploads may take: as set, else 0 if other machines may
        reach the server.
        """
        if self.uploads_mb is not None:
            return self.uploads_mb
        if self.exposed or self.allowed_hosts is not None:
            return 0
        return UPLOADS_MB

    @property
    def hands_out_voxels(self) -> bool:
        """Return True if pages may have voxels: as set, else if no token is required."""
        if self.hand_out_voxels is None:
            return not self.bearers
        return self.hand_out_voxels

    @property
    def most_pixels(self) -> int:
        """Return the most pixels in one picture."""
        return self.max_pixels or COMMAND_PIXELS

    @property
    def answering(self) -> Self:
        """Return the settings of a server, whose pictures are smaller by default: those of many
        clients are in memory at once.
        """
        return self.model_copy(update={"max_pixels": self.max_pixels or ANSWER_PIXELS})

    def trusts(self, host: str) -> bool:
        """Return True if a connection from this address is a trusted proxy's, whose headers
        name the client.
        """
        try:
            return any(ip_address(host) in ip_network(each) for each in self.trusted_proxies)
        except ValueError:
            return False

    def hosts(self) -> tuple[str, ...] | None:
        """Return the host names that requests may use, in lower case; None for any."""
        if self.allowed_hosts is not None:
            return tuple(name.lower() for name in self.allowed_hosts)
        if self.exposed:
            return None
        return tuple(dict.fromkeys((*LOOPBACK_HOSTS, self.host.lower())))


def read_settings(config: Path | None = None, **given: Any) -> Settings:
    """Read the settings: those ``given``, then the environment's, then those in the file
    ``config``.

    Raises pydantic's ValidationError; ValueError if the file is not TOML, or if the environment has
    a variable of a former name; OSError if the file cannot be read.
    """
    for former, sentence in FORMER_SETTING_NAMES.items():
        variable = f"ISOGI_{former.upper()}"
        if variable in os.environ:
            raise ValueError(f"{variable}: {former} {sentence}")
    if config is None:
        return Settings(**given)
    # Raise OSError for a missing file, which pydantic would take as an empty one.
    with config.open("rb"):

        class Configured(Settings):
            """Settings with a file."""

            model_config = SettingsConfigDict(toml_file=config)

        try:
            return Configured(**given)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{config}: {error}") from error
