"""docker-compose.yml: what it starts bakes, and what it says of services keeps them apart."""

import re
from pathlib import Path

import pytest

from tests.cluster.composed import COMPOSE, FILED, SERVICES, Composed
from tests.cluster.processes import ROOT, final, metric, until
from tests.s3 import S3Server

CHECKED = 1.0
"""Seconds between two health checks: each of them is a process that starts Python."""


@pytest.mark.cluster
def test_commands_of_the_compose_file_bake_into_the_bucket(small_scene: Path) -> None:
    with S3Server() as s3, Composed(s3, small_scene) as running:
        running.start("scheduler")
        until(lambda: running.healthy("scheduler"), pause=CHECKED)
        for service in ("worker", "worker", "server"):
            running.start(service)
        until(lambda: running.healthy("worker") and running.healthy("server"), pause=CHECKED)
        with running.client() as client:
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
    images += re.findall(
        "^FROM (.*)$", (ROOT / "Dockerfile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(images) == 2 and all(
        re.search(r":v?\d+\.\S+@sha256:[0-9a-f]{64}$", image) for image in images
    )
    for service in SERVICES.values():
        assert not [
            name for name in service.get("environment", {}) if re.search("KEY|SECRET|TOKEN", name)
        ]
        assert set(service["secrets"]) <= set(COMPOSE["secrets"])


def test_only_servers_have_a_way_out() -> None:
    assert COMPOSE["networks"]["inside"]["internal"] is True
    assert {name: service["networks"] for name, service in SERVICES.items()} == {
        **{name: ["inside"] for name in ("store", "scheduler", "worker")},
        "server": ["inside", "front"],
    }


def test_the_store_holds_no_key_of_the_cluster() -> None:
    held = {
        name: {FILED[secret] for secret in service["secrets"]} for name, service in SERVICES.items()
    }
    assert not held["store"] & {"ca.pem", "node.pem", "node.key", "token"}
    assert not any("store.key" in files for name, files in held.items() if name != "store")
    assert (
        not held["scheduler"] & {"s3_key", "s3_secret", "token"} and "token" not in held["worker"]
    )
    assert not [file for files in held.values() for file in files if "ca.key" in file]


def test_no_two_services_write_the_same_volume() -> None:
    volumes = [volume for service in SERVICES.values() for volume in service.get("volumes", ())]
    written = [volume.split(":")[0] for volume in volumes if not volume.endswith(":ro")]
    assert len(written) == len(set(written)) and set(written) == set(COMPOSE["volumes"])


@pytest.mark.parametrize("name", SERVICES)
def test_every_service_has_limits_a_health_check_and_no_rights(name: str) -> None:
    service = SERVICES[name]
    assert all(re.fullmatch(r"/tmp:size=\d+m", folder) for folder in service["tmpfs"])
    assert service["restart"] == "unless-stopped" and service["healthcheck"]
    assert service["read_only"] and service["mem_limit"] and service["pids_limit"]
    assert (service["cap_drop"], service["security_opt"]) == (["ALL"], ["no-new-privileges:true"])


def test_services_speak_tls_alone_to_each_other() -> None:
    parts = [
        part
        for each in SERVICES.values()
        for part in (*each["command"], *each.get("environment", {}).values())
    ]
    assert not [part for part in parts if str(part).startswith(("tcp://", "http://"))]
    assert "--cert" in SERVICES["store"]["command"]
