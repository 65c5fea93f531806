"""Uploads: volumes that clients send, read by a process of their own and kept in a folder."""
