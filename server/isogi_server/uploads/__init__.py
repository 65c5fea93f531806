"""Uploads: volumes and light probes that clients send, read by a separate process and kept in a
folder.
"""
