"""Failures that their text explains to a user. Their exit codes are those of `zloam --help`."""

from __future__ import annotations


class Explained(RuntimeError):
    """A failure that is reported without a stack trace."""

    exit_code = 1


class Misuse(Explained):
    """A wrong command line or configuration."""

    exit_code = 2


class FileTrouble(Explained):
    """A file can't be read or written, or a port is taken."""

    exit_code = 3
