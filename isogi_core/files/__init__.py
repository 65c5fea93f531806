"""Readers and writers of the file formats that the domain itself speaks: volumes and light probes."""
