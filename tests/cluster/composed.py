"""docker-compose.yml, without Docker: its very commands and health checks as processes on loopback,
over a small S3.
"""

import re
import subprocess
from pathlib import Path
from typing import Any

import httpx
import psutil
import yaml

from tests.cluster.processes import ROOT, Cluster, Started, end, free_port
from tests.s3 import S3Server

COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
SERVICES: dict[str, Any] = COMPOSE["services"]
FILED = {name: Path(secret["file"]).name for name, secret in COMPOSE["secrets"].items()}
TOKEN = "a-token-of-the-tests"


class Composed(Cluster):
    """The services, with hosts and ports of this machine in place of the containers'."""

    def __init__(self, s3: S3Server, scene: Path) -> None:
        super().__init__()
        self.http = free_port()
        self._scene = scene
        self._s3 = s3
        self._health: dict[str, str] = {}
        self.started: dict[str, list[Started]] = {}
        for name, text in self._secrets().items():
            (self.certificates / name).write_text(text, encoding="ascii")

    def _secrets(self) -> dict[str, str]:
        """What the files of secrets hold, without the certificates."""
        known = self._s3.environment
        authority = (self.certificates / "ca.pem").read_text(
            encoding="ascii"
        )  # the store here speaks no TLS
        keys = {
            "s3_key": known["AWS_ACCESS_KEY_ID"],
            "s3_secret": known["AWS_SECRET_ACCESS_KEY"],
            "token": TOKEN,
        }
        return {**keys, "store-ca.pem": authority}

    def start(self, service: str) -> None:
        """Run a service's command in its environment."""
        self.started.setdefault(service, []).append(self._start(service))

    def kill(self, service: str) -> None:
        """Kill the first process of a service, and what it has started."""
        end(self.started[service][0])

    def restart(self) -> None:
        """Start again what has ended, as ``restart: unless-stopped`` has it."""
        for service, processes in self.started.items():
            self.started[service] = [
                each if each.poll() is None else self._start(service) for each in processes
            ]

    def client(self) -> httpx.Client:
        """One that the server knows."""
        known = {"Authorization": f"Bearer {TOKEN}"}
        return httpx.Client(base_url=f"http://127.0.0.1:{self.http}", headers=known, timeout=60.0)

    def _start(self, service: str) -> Started:
        given = SERVICES[service].get("environment", {})
        self._health[service] = str(
            free_port()
        )  # the health check asks the one that was started last
        environment = {name: self._here(str(value), service) for name, value in given.items()}
        parts = [*SERVICES[service].get("entrypoint", ()), *SERVICES[service]["command"]]
        return self.run(
            *(self._here(part, service) for part in parts),
            environment={
                **self._s3.environment,
                "AWS_SECRET_ACCESS_KEY": "none of it",
                **environment,
            },
            cwd=self._scene.parent,
            stderr=subprocess.DEVNULL,
        )

    def healthy(self, service: str) -> bool:
        """Whether a service's health check says so."""
        kind, program, *rest = [
            self._here(part, service) for part in SERVICES[service]["healthcheck"]["test"]
        ]
        assert (kind, program) == ("CMD", "python")
        return self.run(program, *rest, stderr=subprocess.DEVNULL).wait() == 0

    def listening(self) -> set[str]:
        """The addresses at which any of the processes listens."""
        family = [
            process for each in self.alive() for process in (each, *each.children(recursive=True))
        ]
        connections = [each for process in family for each in process.net_connections("inet")]
        return {each.laddr.ip for each in connections if each.status == psutil.CONN_LISTEN}

    def _here(self, text: str, service: str) -> str:
        """What a part of the file means here."""
        text = re.sub(
            r"\$\{(\w+)[^}]*\}", lambda found: {"ISOGI_SCENE": str(self._scene)}[found[1]], text
        )
        text = re.sub(
            r"/run/secrets/(\w+)", lambda found: str(self.certificates / FILED[found[1]]), text
        )
        text = (
            text.replace("$$", "$")
            .replace("8787", self._health[service])
            .replace("https://store:9000", self._s3.endpoint)
            .replace("s3://isogi/light", self._s3.url)
        )
        if "://" in text:
            text = text.replace("scheduler", "127.0.0.1")
        return (
            text.replace("8786", str(self.port))
            .replace("8000", str(self.http))
            .replace("0.0.0.0", "127.0.0.1")
        )
