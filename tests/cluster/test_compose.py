"""docker-compose.yml, without Docker: its very commands and health checks as processes on loopback, over a small S3."""

import re
import subprocess
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest
import yaml

from tests.cluster.processes import ROOT, Cluster, final, free_port, metric, until
from tests.s3 import S3Server

pytestmark = pytest.mark.slow

COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
SERVICES: dict[str, Any] = COMPOSE["services"]
FILED = {name: Path(secret["file"]).name for name, secret in COMPOSE["secrets"].items()}
TOKEN = "a-token-of-the-tests"


class Composed(Cluster):
    """The services, with hosts and ports of this machine in place of the containers'."""

    def __init__(self, s3: S3Server, scene: Path) -> None:
        super().__init__()
        self.http = free_port()
        self._scene, self._s3 = scene, s3
        self._health: dict[str, str] = {}
        for name, text in self._secrets().items():
            (self.certificates / name).write_text(text, encoding="ascii")

    def _secrets(self) -> dict[str, str]:
        """What the files of secrets hold, without the certificates."""
        known = self._s3.environment
        return {"s3_key": known["AWS_ACCESS_KEY_ID"], "s3_secret": known["AWS_SECRET_ACCESS_KEY"], "token": TOKEN}

    def start(self, service: str) -> None:
        """Run a service's command in its environment."""
        given = SERVICES[service].get("environment", {})
        self._health[service] = str(free_port())
        environment = {name: self._here(str(value), service) for name, value in given.items()}
        parts = [*SERVICES[service].get("entrypoint", ()), *SERVICES[service]["command"]]
        self.run(
            *(self._here(part, service) for part in parts),
            environment={**self._s3.environment, "AWS_SECRET_ACCESS_KEY": "none of it", **environment},
            cwd=self._scene.parent,
            stderr=subprocess.DEVNULL,
        )

    def healthy(self, service: str) -> bool:
        """Whether a service's health check says so."""
        kind, program, *rest = [self._here(part, service) for part in SERVICES[service]["healthcheck"]["test"]]
        assert (kind, program) == ("CMD", "python")
        return self.run(program, *rest, stderr=subprocess.DEVNULL).wait() == 0

    def listening(self) -> set[str]:
        """The addresses at which any of the processes listens."""
        own = [psutil.Process(each.pid) for each in self._running if each.poll() is None]
        family = [process for each in own for process in (each, *each.children(recursive=True))]
        connections = [each for process in family for each in process.net_connections("inet")]
        return {each.laddr.ip for each in connections if each.status == psutil.CONN_LISTEN}

    def _here(self, text: str, service: str) -> str:
        """What a part of the file means here."""
        text = re.sub(r"\$\{(\w+)[^}]*\}", lambda found: {"ISOGI_SCENE": str(self._scene)}[found[1]], text)
        text = re.sub(r"/run/secrets/(\w+)", lambda found: str(self.certificates / FILED[found[1]]), text)
        text = (
            text.replace("$$", "$")
            .replace("8787", self._health[service])
            .replace("https://store:9000", self._s3.endpoint)
            .replace("s3://isogi/light", self._s3.url)
        )
        text = text.replace("scheduler", "127.0.0.1") if "://" in text else text
        return text.replace("8786", str(self.port)).replace("8000", str(self.http)).replace("0.0.0.0", "127.0.0.1")


def test_commands_of_the_compose_file_bake_into_the_bucket(small_scene: Path) -> None:
    with S3Server() as s3, Composed(s3, small_scene) as running:
        running.start("scheduler")
        until(lambda: running.healthy("scheduler"))
        for service in ("worker", "worker", "server"):
            running.start(service)
        until(lambda: running.healthy("worker") and running.healthy("server"))
        known = {"Authorization": f"Bearer {TOKEN}"}
        with httpx.Client(base_url=f"http://127.0.0.1:{running.http}", headers=known, timeout=60) as client:
            until(lambda: metric(client, "isogi_workers") == 2.0)
            assert final(client)
            assert metric(client, "isogi_paths_total") > 0.0
        assert running.listening() == {"127.0.0.1"}
        assert any("/c/" in key for key in s3.objects)


def test_only_servers_can_be_reached_and_only_on_loopback() -> None:
    published = {name: service["ports"] for name, service in SERVICES.items() if "ports" in service}
    assert list(published) == ["server"]
    assert all(port.startswith("127.0.0.1:") for port in published["server"])


def test_foreign_images_are_pinned_and_no_secret_is_in_files() -> None:
    images = [service["image"] for service in SERVICES.values() if "build" not in service]
    images += re.findall("^FROM (.*)$", (ROOT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(images) == 2 and all(re.search(r":v?\d+\.\S+@sha256:[0-9a-f]{64}$", image) for image in images)
    for service in SERVICES.values():
        assert not [name for name in service.get("environment", {}) if re.search("KEY|SECRET|TOKEN", name)]
        assert set(service["secrets"]) <= set(COMPOSE["secrets"])


def test_every_service_has_a_health_check_and_comes_again() -> None:
    for name, service in SERVICES.items():
        assert service["restart"] == "unless-stopped" and service["healthcheck"], name


def test_every_service_has_limits_and_no_rights() -> None:
    for service in SERVICES.values():
        assert (
            service["read_only"] and service["cap_drop"] == ["ALL"] and service["mem_limit"] and service["pids_limit"]
        )
        assert service["security_opt"] == ["no-new-privileges:true"]


def test_services_speak_tls_alone_to_each_other() -> None:
    spoken = [
        str(part) for each in SERVICES.values() for part in (*each["command"], *each.get("environment", {}).values())
    ]
    assert not [part for part in spoken if part.startswith(("tcp://", "http://"))]
    assert "--cert" in SERVICES["store"]["command"]
