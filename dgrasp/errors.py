"""Errors that a user can act on. The command line prints only their text and exits with code 2."""

from __future__ import annotations


class DGraspError(Exception):
    """Base of all errors raised for wrong use or bad input."""


class ConfigError(DGraspError):
    """A configuration that cannot be used; the message lists every problem with its path."""


class DataError(DGraspError):
    """A file, label, mesh or checkpoint that is missing, damaged or does not fit."""
