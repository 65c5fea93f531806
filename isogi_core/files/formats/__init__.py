"""Readers of volumes by the libraries that their fields keep; each is loaded when a file of its
kind is opened.
"""
