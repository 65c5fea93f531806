"""Certificates of clusters: those made at start, and those given for one that is joined."""

from distributed import Security

from worker.pool import temporary_security


def test_each_cluster_has_a_key_of_its_own() -> None:
    one, other = temporary_security(), temporary_security()
    assert one.require_encryption
    assert one.tls_worker_key == one.tls_client_key != other.tls_client_key
    assert isinstance(one, Security) and "PRIVATE" not in repr(one)
