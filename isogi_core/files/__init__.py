"""Readers and writers of the domain's own files: volumes, light probes and scene files."""
