"""Settings of the server process: each is an environment variable ``ISOGI_…``, a few also an option."""

import os
from typing import Annotated

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

LOOPBACK = ("127.0.0.1", "localhost", "::1")


def cores() -> int:
    """Cores that this process may use, at least 1."""
    return max(1, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


class Settings(BaseSettings):
    """What one server process may do and how much of it. Raises pydantic's ValidationError."""

    model_config = SettingsConfigDict(env_prefix="ISOGI_", frozen=True)

    host: str = Field("127.0.0.1", description="Address to listen on.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on; 0 takes a free one.")
    workers: int = Field(default_factory=cores, ge=1, le=1024, description="Baking processes; default: one per core.")
    store: str | None = Field(None, description="Path or URL of the cache; default: the user's cache folder.")
    memory_mb: int = Field(512, ge=1, le=1 << 20, description="Megabytes of light that a scene keeps in memory.")
    scheduler: str | None = Field(None, description="Address of a Dask scheduler instead of own workers.")
    allowed_hosts: Annotated[tuple[str, ...] | None, NoDecode] = Field(
        None,
        description="Host names that requests may use, comma-separated; default: the loopback names when"
        " listening on loopback (a defence against DNS rebinding), else any.",
    )
    max_pixels: int = Field(4096 * 4096, ge=1, description="Most pixels in one picture.")
    max_paths: int = Field(2**26, ge=1, description="Most paths (pixels × samples) in one path-traced picture.")
    render_threads: int = Field(
        default_factory=lambda: max(4, 2 * cores()),
        ge=1,
        le=256,
        description="Frames rendered or waited for at once.",
    )
    render_queue: int = Field(64, ge=0, description="Frames that may wait for a thread; beyond that: 429.")
    shutdown_seconds: int = Field(10, ge=0, description="How long a stopping server finishes open requests.")

    @field_validator("allowed_hosts", mode="before")
    @classmethod
    def split(cls, value: object) -> object:
        """The names in a comma-separated text."""
        return tuple(filter(None, map(str.strip, value.split(",")))) if isinstance(value, str) else value

    def hosts(self) -> tuple[str, ...] | None:
        """Host names that requests may use; None for any."""
        if self.allowed_hosts is not None:
            return self.allowed_hosts
        return LOOPBACK if self.host in LOOPBACK else None
